"""A biped under commands of speed: courses walked by trained policies, and standing by predictive sampling."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.control.config import LEGGED_SAMPLING, CourseConfig, HierarchyConfig
from pipeline.locomotion.tasks import STAND, WALK, LeggedTask
from pipeline.store import store_root

BODY, FIRST_SEED = "biped", 100
UPPER_HZ, LOWER_HZ = 10.0, 50.0
PHASES = ((0.5, 2.0), (3.0, 6.0), (7.0, 10.0), (11.5, 13.0))
"""Parts of the default profile that count for a speed: from half a second after it was asked for [s]."""
SIDLE = WALK.model_copy(update={
    "instruction": "Walk and step aside at the speeds that you are told, looking ahead.",
    "command": ((0.0, 0.6), (-0.25, 0.25), (0.0, 0.0))})
"""The biped has no hip that turns, so it learns to step aside in place of turning."""
SIDLE_STEPS, SIDLE_SEED = 1_600_000, 100
LANE = CourseConfig(waypoints=((1.0, 0.0), (2.0, 0.6), (3.0, 0.0), (4.0, 0.0)), speed_m_s=0.35)


@dataclass(frozen=True, slots=True)
class Course:
    """One thing that robots are asked to do, and who tries it."""

    upper: str
    lowers: Sequence[str]
    seconds: float
    course: CourseConfig = field(default_factory=CourseConfig)
    task: LeggedTask | None = None
    """That of the policy where None."""
    policy: str = "walk"
    """walk, or sidle: which training drives."""
    most: int = 10**6
    """Attempts a seed, where planning takes about a second for a second of each."""


COURSES: MappingProxyType[str, Course] = MappingProxyType({
    "profile": Course("profile", ("policy", "zero"), 13.0),
    "waypoints, turning": Course("waypoints", ("policy", "zero"), 20.0, LANE),
    "waypoints, sidling": Course("sidle", ("policy", "zero"), 20.0, LANE, policy="sidle"),
    "stand": Course("profile", ("mpc", "zero"), 5.0, CourseConfig(profile=((0, 0),), turn_rad_s=0), STAND, most=10),
    "profile by planning": Course("profile", ("mpc",), 5.0, CourseConfig(profile=((0, 0), (1, 0), (1.5, 0.3))), WALK,
                                  most=4),
})


def policy_of(kind: str, seed: int) -> Path:
    """The policy that drives: of `hardcase measure walk`, or one that sidles; trained now where it is not there."""
    from flows.rl.order import order_of
    from flows.rl.training import POLICY, trained
    from pipeline.ppo.config import PPO_CONFIGS, Order

    if kind == "walk":
        folder, order = store_root() / "rl" / "study" / f"{BODY}-walk-{seed}", order_of(BODY, "walk", seed)
    else:
        folder = store_root() / "rl" / "study" / f"{BODY}-sidle-{SIDLE_SEED}"
        ppo = PPO_CONFIGS["walk"].model_copy(update={"steps": SIDLE_STEPS})
        order = Order(body=BODY, name="sidle", task=SIDLE, ppo=ppo, seed=SIDLE_SEED)
    if not (folder / POLICY).exists():
        trained(order, folder)
    return folder / POLICY


def followed(course: Course, lower: str, *, n: int, seed: int, policy: Path | None) -> dict[str, Any]:
    """n attempts of one seed.

    Returns:
        asked, got: speeds forward, left, turning, (ticks, n, 3); alive: not fallen so far, (ticks, n); position:
        (ticks, n, 2); planning: CPU seconds of the lower a second of each robot; reached: waypoints, (n,).
    """
    import numpy as np

    from flows.rl.training import opened
    from pipeline.control.legged import legged_plant
    from pipeline.control.table import legged_hierarchy
    from pipeline.locomotion.bodies import load_legged

    config = HierarchyConfig(robot=BODY, upper=course.upper, lower=lower, upper_hz=UPPER_HZ, lower_hz=LOWER_HZ,
                             seed=seed, sampling=LEGGED_SAMPLING, course=course.course,
                             policy=None if policy is None else str(policy))
    task = course.task or opened(policy or policy_of(course.policy, seed))[2]
    plant = legged_plant(load_legged(BODY), task, n, seed=seed)
    hierarchy = legged_hierarchy(config, plant)
    alive, rows = np.ones(n, bool), []
    for _ in range(round(course.seconds * LOWER_HZ)):
        hierarchy.tick()
        now = plant.motion()
        alive &= ~plant.world.fallen(now)
        rows.append((hierarchy.command, now.velocity, alive.copy(), hierarchy.sensed.position))
    asked, got, standing, position = (np.stack(part) for part in zip(*rows, strict=True))
    return {"asked": asked, "got": got, "alive": standing, "position": position,
            "planning": hierarchy.lower_cpu_s / hierarchy.time_s / n,
            "reached": getattr(hierarchy.upper, "reached", np.zeros(n))}


def parts(seeds: int) -> int:
    """How often `biped_study` says what it does next."""
    return seeds * sum(len(course.lowers) for course in COURSES.values())


def biped_study(*, seeds: int, attempts: int, policy: Path | None, told: Callable[[str], None]) -> dict[str, Any]:
    """Every course by everybody who tries it.

    Args:
        seeds: how many, from FIRST_SEED on.
        attempts: starts a seed; fewer where a course says so.
        policy: walks in every seed; that of each seed's own training where None.
        told: called with what is done next, once for each of `parts(seeds)`.
    """
    found: dict[str, Any] = {}
    for name, course in COURSES.items():
        arms: dict[str, Any] = {}
        for lower in course.lowers:
            runs: list[dict[str, Any]] = []
            for seed in range(FIRST_SEED, FIRST_SEED + seeds):
                told(f"biped, {name}: {lower}")
                drives = None if course.task is not None else (
                    policy if policy is not None and course.policy == "walk" else policy_of(course.policy, seed))
                n = min(attempts, course.most)
                runs.append(followed(course, lower, n=n, seed=seed, policy=drives))
            arms[lower] = _told(runs, phases=PHASES if name == "profile" else ())
        found[name] = arms
    return found


def _told(runs: Sequence[Mapping[str, Any]], phases: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """One arm on one course in numbers."""
    import numpy as np

    from pipeline.statistics.bootstrap import bootstrap, mean

    full = np.stack([run["alive"][-1] for run in runs]).astype(float)
    length = np.stack([run["alive"].sum(axis=0) / LOWER_HZ for run in runs])
    reached = np.stack([run["reached"] for run in runs])
    told: dict[str, Any] = {
        name: _limits(bootstrap(values, mean, np.random.default_rng(0)))
        for name, values in (("full", full), ("length_s", length), ("reached", reached))}
    told |= {"attempts": full.shape[1], "full_by_seed": full.mean(axis=1).tolist(),
             "lower_cpu_s_a_s": float(np.mean([run["planning"] for run in runs])), "phases": []}
    for start, end in phases:
        told["phases"].append(_phase(runs, round(start * LOWER_HZ), round(end * LOWER_HZ)))
    return told | _curves(runs)


def _phase(runs: Sequence[Mapping[str, Any]], start: int, end: int) -> dict[str, Any]:
    """Speed forward over some ticks, of the attempts that stood to their end; None where none did."""
    import numpy as np

    asked, got, spread = [], [], []
    for run in runs:
        stood = run["alive"][end - 1]
        asked.append(run["asked"][start:end, stood, 0].mean(axis=0))
        got.append(run["got"][start:end, stood, 0].mean(axis=0))
        spread.append(run["got"][start:end, stood, 1].mean(axis=0))
    asked, got, aside = (np.concatenate(part) for part in (asked, got, spread))
    if not len(got):
        return {"attempts": 0}
    return {"attempts": len(got), "asked_m_s": float(asked.mean()), "got_m_s": float(got.mean()),
            "off_m_s": float(np.abs(got - asked).mean()), "worst_m_s": float(np.abs(got - asked).max()),
            "aside_m_s": float(np.abs(aside).mean())}


def _curves(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Asked and tracked speed forward, and the share that stands, ten times a second; the way of one robot."""
    import numpy as np

    every = round(LOWER_HZ / 10)
    got = np.concatenate([np.where(run["alive"], run["got"][..., 0], np.nan) for run in runs], axis=1)
    asked = np.concatenate([run["asked"][..., 0] for run in runs], axis=1)
    ticks = len(got) // every * every
    smooth = got[:ticks].reshape(-1, every, got.shape[1]).mean(axis=1)
    stands = np.isfinite(smooth).any(axis=1)
    quartiles = np.nanquantile(smooth[stands], [0.25, 0.5, 0.75], axis=1) if stands.any() else np.zeros((3, 0))
    return {"asked_m_s": asked[:ticks:every].mean(axis=1).tolist(), "got_m_s": quartiles.tolist(),
            "standing": np.concatenate([run["alive"] for run in runs], axis=1)[:ticks:every].mean(axis=1).tolist(),
            "way_m": runs[0]["position"][::every, 0].round(4).tolist()}


def _limits(interval: Any) -> dict[str, float]:
    return {"estimate": interval.estimate, "low": interval.low, "high": interval.high}
