"""Tasks: where attempts start, when they have succeeded, and what is rewarded."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from pydantic import Field

from pipeline.errors import unknown
from schemas.base import Frozen
from schemas.scene import SceneFamily, SceneSpec


class Stratum(Frozen):
    """One kind of start; the sign of y is drawn, so a stratum lies on both sides."""

    x_m: tuple[float, float]
    y_abs_m: tuple[float, float]
    yaw_rad: tuple[float, float] = (-np.pi / 4, np.pi / 4)
    half_m: float = 0.02
    rare_share: float = Field(default=0.0, ge=0, le=1, description="share of the rare starts; 0 for a common kind")


class PickPlace(Frozen):
    """Pick the cube and put it on the mark; lengths [m]."""

    instruction: str = "Pick up the cube and place it on the mark."
    ticks: int = 150
    strata: dict[str, Stratum] = Field(default={
        "common": Stratum(x_m=(0.24, 0.38), y_abs_m=(0.0, 0.13)),
        "beside": Stratum(x_m=(0.04, 0.14), y_abs_m=(0.23, 0.31), rare_share=0.75),
        "large": Stratum(x_m=(0.24, 0.38), y_abs_m=(0.0, 0.13), half_m=0.031, rare_share=0.25),
    })
    target_x_m: tuple[float, float] = (0.22, 0.40)
    target_y_m: tuple[float, float] = (-0.16, 0.16)
    target_away_m: float = 0.10
    within_m: float = Field(default=0.025, description="cube to target, horizontally")
    on_table_m: float = Field(default=0.006, description="cube's height above rest")
    hand_away_m: float = 0.05
    open_m: float = Field(default=0.066, description="finger opening that counts as open")
    hold_ticks: int = 4
    weights: dict[str, float] = Field(
        default={"reach": 0.1, "grasp": 0.2, "carry": 0.5, "success": 5.0, "effort": -1.0},
        description="reward terms: exp(-tool to cube / 0.1 m), held, exp(-cube to target / 0.1 m), success, |dq|^2",
    )

    @property
    def common(self) -> tuple[str, ...]:
        """Strata that are not rare."""
        return tuple(n for n, s in self.strata.items() if s.rare_share == 0)

    @property
    def rare(self) -> dict[str, float]:
        """Rare strata and their shares among the rare starts."""
        return {n: s.rare_share for n, s in self.strata.items() if s.rare_share > 0}

    def nearest_half(self, centre_z_m: float) -> float:
        """Half edge of the cube whose centre rests at about this height: the size as it can be perceived [m]."""
        return min((k.half_m for k in self.strata.values()), key=lambda half: abs(half - centre_z_m))

    def sample_target(self, rng: np.random.Generator, x: float, y: float) -> tuple[float, float]:
        """A mark at least `target_away_m` from an object at x, y [m]."""
        while True:
            target = float(rng.uniform(*self.target_x_m)), float(rng.uniform(*self.target_y_m))
            if np.hypot(target[0] - x, target[1] - y) >= self.target_away_m:
                return target


TASKS: MappingProxyType[str, PickPlace] = MappingProxyType({"pick-place": PickPlace()})
"""Task name -> its config. Add one: a task of its own and an entry here."""

FAMILY_BASE: MappingProxyType[SceneFamily, int] = MappingProxyType(
    {"demo": 1, "augment": 2, "gate": 3, "deploy": 4, "exam": 5, "study": 6, "teleop": 7}
)
"""First word of every seed: families can never share one."""


def load_task(name: str) -> PickPlace:
    """The task of that name; ConfigError lists the valid ones."""
    if name not in TASKS:
        raise unknown("task", name, TASKS)
    return TASKS[name]


def scene_seed(family: SceneFamily, *parts: int) -> int:
    """A 63-bit seed that no other family can produce: the family is part of what is hashed and kept in the top bits."""
    words = np.random.SeedSequence([FAMILY_BASE[family], *parts]).generate_state(2, np.uint32)
    return (FAMILY_BASE[family] << 59) | (int(words[0]) << 27) | (int(words[1]) >> 5)


def sample_scene(task: str, family: SceneFamily, seed: int, stratum: str, *, robot: str = "arm",
                 scene: str = "table", twin: int | None = None) -> SceneSpec:
    """The start that this seed gives in this stratum; the target lies at least `target_away_m` from the cube."""
    config = load_task(task)
    if stratum not in config.strata:
        raise unknown("stratum", stratum, config.strata)
    kind, rng = config.strata[stratum], np.random.default_rng(seed)
    x, y = rng.uniform(*kind.x_m), rng.uniform(*kind.y_abs_m) * rng.choice([-1.0, 1.0])
    yaw = rng.uniform(*kind.yaw_rad)
    target = config.sample_target(rng, x, y)
    return SceneSpec(family=family, seed=seed, robot=robot, scene=scene, task=task, stratum=stratum,
                     object_xy_m=(float(x), float(y)), object_yaw_rad=float(yaw), object_half_m=kind.half_m,
                     target_xy_m=target, twin=twin)


def mixed_strata(task: str, n: int, rare_share: float, rng: np.random.Generator) -> list[str]:
    """Strata of n starts in random order: exactly the rounded share is rare, split by the strata's own shares."""
    config = load_task(task)
    return mixed(config.common, config.rare, n, rare_share, rng)


def mixed(common: Sequence[str], rares: Mapping[str, float], n: int, rare_share: float,
          rng: np.random.Generator) -> list[str]:
    """As `mixed_strata`, for strata and shares of any task; all are common where there are no rare ones."""
    rare = round(n * rare_share) if rares else 0
    names: list[str] = []
    for name, share in rares.items():
        names += [name] * round(rare * share)
    names = (names + [*rares][:1] * rare)[:rare]
    names += [common[i % len(common)] for i in range(n - rare)]
    return [names[i] for i in rng.permutation(n)]
