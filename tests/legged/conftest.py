"""Policies made by hand, and bipeds of a twin at work with them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.world import LeggedWorld
from pipeline.ppo.export import build
from pipeline.ppo.normaliser import Normaliser
from pipeline.ppo.policy import LeggedPolicy
from pipeline.recording import read_episode
from pipeline.shadow.limits import Limits
from pipeline.shadow.riders import Riders
from pipeline.shadow.sizes import legged
from schemas.recipe import DeployConfig, Recipe
from stages.deploy_legged import deploy_legged

RECIPE = Recipe(name="tests", robot="biped", scene="ground", task="stand", threads=1, deploy=DeployConfig(episodes=8))
TWIN = 3


def write(path: Path, width: int, joints: int, body: str, seed: int | None, scale: float = 0.02) -> Path:
    """A policy of one hidden layer; without a seed it asks for nothing."""
    rng = np.random.default_rng(seed)
    amount = 0.0 if seed is None else scale
    weights = {"mlp_extractor.policy_net.0.weight": amount * rng.standard_normal((8, width)),
               "mlp_extractor.policy_net.0.bias": np.zeros(8),
               "action_net.weight": amount * rng.standard_normal((joints, 8)), "action_net.bias": np.zeros(joints)}
    path.write_bytes(build(weights, Normaliser(width), {"body": body}))
    return path


@pytest.fixture(scope="session")
def files(tmp_path_factory) -> Mapping[str, Path]:
    """Name -> policy file: three of the biped, one of another robot, and one that is no model."""
    folder = tmp_path_factory.mktemp("legged-policies")
    world = LeggedWorld(load_legged("biped"), load_legged_task("stand"), 1)
    width, joints = world.width, world.action_size
    made = {name: write(folder / f"{name}.onnx", width, joints, "biped", seed, 0.2)
            for name, seed in (("champion", 1), ("other", 2), ("still", None))}
    made["nan"] = write(folder / "nan.onnx", width, joints, "biped", 3, float("nan"))
    made["wider"] = write(folder / "wider.onnx", width + 2, joints, "strider", 1)
    made["hostile"] = folder / "hostile.onnx"
    made["hostile"].write_bytes(b"\x80\x04\x95\x1b\x00\x00\x00cos\nsystem\n")
    return made


@pytest.fixture(scope="session")
def work(files, interrupted, tmp_path_factory) -> Callable[..., SimpleNamespace]:
    """Lets the champion work; `happens` is called with the candidates' process ids at tick `at`."""
    world = LeggedWorld(load_legged("biped"), load_legged_task("stand"), 1)
    sizes = legged(world.width, world.action_size)

    def working(candidates: Mapping[str, Path] | None = None, limits: Limits | None = None, *, at: int = -1,
                happens: Callable[[Mapping[str, int]], None] = lambda pids: None) -> SimpleNamespace:
        champion = interrupted(LeggedPolicy)(files["champion"])
        folder = tmp_path_factory.mktemp("legged-deployed")
        with Riders(candidates or {}, limits, patient=True, sizes=sizes) as riders:
            champion.at, champion.happens = at, lambda: happens(riders.pids())
            done = deploy_legged(champion, "c" * 16, RECIPE, seed=3, twin=TWIN, generation=0, software={},
                                 folder=folder, riders=riders)
        return SimpleNamespace(done=done, states=done.shadows, files=[r.path for r in done.recorded],
                               attempts=[read_episode(r.path) for r in done.recorded])

    return working


@pytest.fixture(scope="session")
def alone(work) -> SimpleNamespace:
    """The champion with nobody in its shadow."""
    return work()
