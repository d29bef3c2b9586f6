"""TrainingRecord: what a finished training has left as training.json, or an unfinished one in its checkpoint."""

from collections.abc import Iterator
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, Field, ValidationError, model_validator

from pipeline.errors import PolicyError
from pipeline.policies.resuming import newest
from pipeline.ppo.checkpoint import load
from pipeline.ppo.config import Order
from pipeline.ppo.curves import Point
from schemas.base import Frozen, ShortId

FILE = "training.json"
MOST_BYTES = 64 << 20
"""No training of ours leaves more; what is larger is not read."""
AGAIN = "name a folder that hardcase rl train has left, or finish the training: --resume"


class TrainingRecord(Frozen):
    """One training: what was ordered and what every iteration brought."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    order: Order
    id: ShortId = Field(description="what its checkpoints are known by")
    steps: int = Field(ge=0, description="environment steps done")
    cpu_s: float = Field(ge=0, allow_inf_nan=False, description="[s]")
    wall_s: float = Field(ge=0, allow_inf_nan=False, description="[s]")
    curve: tuple[Point, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def curve_is_of_this_order(self) -> Self:
        """Steps rise, every value is a number, and each point has the terms of the task."""
        steps = [point["step"] for point in self.curve]
        if any(b <= a for a, b in pairwise(steps)) or steps[0] < 1:
            raise ValueError("the steps of the curve do not rise")
        for point in self.curve:
            if set(point["terms"]) != set(self.order.task.weights):
                raise ValueError(f"step {point['step']}: the terms are not those of the task")
            if not all(map(isfinite, _numbers(point))):
                raise ValueError(f"step {point['step']}: a value is not finite")
        return self

    @property
    def over(self) -> bool:
        """Whether all steps are done."""
        return self.steps >= self.order.ppo.steps


def _numbers(point: Any) -> Iterator[float]:
    for value in point.values():
        if isinstance(value, dict):
            yield from _numbers(value)
        elif value is not None:
            yield value


def read_record(folder: Path) -> TrainingRecord:
    """What a training has left in its folder; of one that is not finished, its last checkpoint tells.

    Raises:
        PolicyError: there is none, or it is damaged; says the field that is wrong.
        ConfigError: its order names a reward term or a body that there is not.
    """
    file, checkpoint = folder / FILE, newest(folder) if folder.is_dir() else None
    if file.is_file():
        if file.stat().st_size > MOST_BYTES:
            raise PolicyError(f"training.json of {file.stat().st_size >> 20} MiB", where=file, mend=AGAIN)
        try:
            return TrainingRecord.model_validate_json(file.read_bytes())
        except ValidationError as error:
            return _refused(error, file)
    if checkpoint is None:
        raise PolicyError("no training here", where=folder, mend=AGAIN)
    facts = load(checkpoint).facts
    values = {key: facts.get(key) for key in ("order", "steps", "cpu_s", "wall_s", "curve")}
    try:
        order = Order.model_validate(values["order"])
        return TrainingRecord.model_validate({**values, "id": order.id})
    except ValidationError as error:
        return _refused(error, checkpoint)


def _refused(error: ValidationError, file: Path) -> TrainingRecord:
    first = error.errors()[0]
    field = ".".join(map(str, first["loc"])) or "the file"
    raise PolicyError(f"not the record of a training: {field}: {first['msg'].removeprefix('Value error, ')}",
                      where=file, mend=AGAIN) from error
