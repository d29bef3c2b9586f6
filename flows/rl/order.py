"""What a training is asked for, out of names and numbers that people type."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.documents import from_values
from pipeline.errors import unknown
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.tasks import load_legged_task
from pipeline.ppo.config import PPO_CONFIGS, Order, PpoConfig
from pipeline.ppo.suited import SUITED


def order_of(body: str, task: str, seed: int, *, stratum: str | None = None,
             given: Mapping[str, float | None] | None = None, goes_on: str | None = None) -> Order:
    """The order of a training.

    Args:
        body, task, stratum: as on the command line; a wrong one is told here, before anything is trained.
        seed: of starts, weights and draws.
        given: numbers of PpoConfig; those that are None stay as the task, or the body on this task, has them.

    Raises:
        ConfigError: a name or number that cannot be used.
    """
    loaded, name = load_legged_task(task), Path(task).stem
    load_legged(body)
    if stratum is not None and stratum not in loaded.starts:
        raise unknown("stratum", stratum, loaded.starts)
    if (own := SUITED.get((task, body))) is not None:
        loaded = loaded.model_copy(update=dict(own.task))
    numbers = (own.ppo if own else PPO_CONFIGS.get(name, PpoConfig())).model_dump() | {
        key: value for key, value in (given or {}).items() if value is not None}
    ppo = from_values(numbers, PpoConfig, where="the training's numbers", example="fields: pipeline/ppo/config.py")
    return Order(body=body, name=name, task=loaded, stratum=stratum, goes_on=goes_on, ppo=ppo, seed=seed)
