"""Reaches of the arm: inverse kinematics against predictive sampling, beside zero action, on the same goals."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pipeline.control.config import HierarchyConfig

SECONDS, LAST_S = 2.0, 0.2
"""Length of an attempt, and of its end, whose mean error is the final one [s]."""
WITHIN_M = (0.01, 0.005)
FIRST_SEED = 100
"""Numbers were tuned on seeds 0 and 1."""
STRONG_1_S = 3.0
MOST_POINTS = 100
"""Of a curve in the JSON file."""

LOWERS: MappingProxyType[str, Mapping[str, Any]] = MappingProxyType({
    "zero action": {"lower": "zero"},
    "IK": {"lower": "ik"},
    "MPC": {"lower": "mpc"},
    "IK, integral": {"lower": "ik", "integral_1_s": STRONG_1_S},
    "MPC, integral": {"lower": "mpc", "integral_1_s": STRONG_1_S},
})
"""Who acts -> what it changes in the config."""
TASKS: MappingProxyType[str, tuple[Mapping[str, Any], bool, tuple[str, ...]]] = MappingProxyType({
    "target, nominal": ({"upper": "target"}, False, ("zero action", "IK", "MPC")),
    "target, perturbed": ({"upper": "target"}, True, tuple(LOWERS)),
    "path, nominal": ({"upper": "path", "upper_hz": 50.0}, False, ("zero action", "IK", "MPC")),
    "path, perturbed": ({"upper": "path", "upper_hz": 50.0}, True, ("zero action", "IK", "MPC")),
})
"""What is asked -> the upper, whether physics is perturbed, and who tries it."""
PAIRS = (("MPC", "IK"), ("MPC, integral", "IK, integral"))


def reached(config: HierarchyConfig, *, n: int, seed: int, perturbed: bool) -> dict[str, Any]:
    """n reaches of one seed: arrays of shape (n,), and the distance to the goal over time, shape (ticks, n)."""
    import numpy as np

    from pipeline.control.arm import ArmPlant
    from pipeline.control.arm_model import apart
    from pipeline.control.reaches import draw_reaches
    from pipeline.control.table import arm_hierarchy

    plant = ArmPlant(draw_reaches(n, seed, perturbed=perturbed))
    hierarchy = arm_hierarchy(config, plant)
    away, behind, effort = [], [], []
    for _ in range(round(SECONDS * config.lower_hz)):
        hierarchy.tick()
        tool = plant.sense().tool[:, :3]
        away.append(np.linalg.norm(tool - plant.goals[:, :3], axis=1))
        behind.append(np.linalg.norm(tool - hierarchy.command[:, :3], axis=1))
        effort.append(plant.effort)
    away, last = np.array(away), round(LAST_S * config.lower_hz)
    _, turn = apart(*plant.hand(), plant.goals)
    return {"away": away, "final_m": away[-last:].mean(axis=0), "behind_m": np.mean(behind, axis=0),
            "turn_rad": turn, "effort": np.mean(effort, axis=0),
            "cpu_s": hierarchy.lower_cpu_s / hierarchy.ticks / n,
            **{f"within_{1000 * limit:g}_mm_s": _settled(away, limit) / config.lower_hz for limit in WITHIN_M}}


def _settled(away: Any, limit: float) -> Any:
    """Ticks after which the hand is within the limit to the end; infinity where it is not at the end, shape (n,)."""
    import numpy as np

    out = away >= limit
    after = np.where(out.any(axis=0), len(away) - np.argmax(out[::-1], axis=0), 0).astype(float)
    return np.where(out[-1], np.inf, after)


def arm_study(*, seeds: int, attempts: int, told: Callable[[str], None]) -> dict[str, Any]:
    """Everybody on every task; medians with intervals over seeds and goals, and pairs on the same goals.

    Args:
        seeds: how many, from FIRST_SEED on.
        attempts: goals a seed.
        told: called with what is done next, once for each of `parts(seeds)`.
    """
    import numpy as np

    found: dict[str, Any] = {}
    for task, (upper, perturbed, who) in TASKS.items():
        arms: dict[str, dict[str, Any]] = {}
        for name in who:
            config = HierarchyConfig.model_validate({**upper, **LOWERS[name]})
            runs = []
            for seed in range(FIRST_SEED, FIRST_SEED + seeds):
                told(f"arm, {task}: {name}")
                runs.append(reached(config, n=attempts, seed=seed, perturbed=perturbed))
            arms[name] = {key: np.stack([run[key] for run in runs]) for key in runs[0] if key != "cpu_s"}
            arms[name]["cpu_s"] = np.array([run["cpu_s"] for run in runs])
        found[task] = {"arms": {name: _told(arm) for name, arm in arms.items()},
                       "pairs": {f"{a} against {b}": _against(arms[a], arms[b])
                                 for a, b in PAIRS if a in arms and b in arms}}
    return found


def parts(seeds: int) -> int:
    """How often `arm_study` says what it does next."""
    return seeds * sum(len(who) for _, _, who in TASKS.values())


MEASURES = ("final_m", "behind_m", "turn_rad", "effort", *(f"within_{1000 * limit:g}_mm_s" for limit in WITHIN_M))


def _told(arm: Mapping[str, Any]) -> dict[str, Any]:
    """One arm in numbers; times are None where most attempts never came there."""
    import numpy as np

    from pipeline.statistics.bootstrap import bootstrap, mean, median

    stride = max(1, arm["away"].shape[1] // MOST_POINTS)
    curve = arm["away"].transpose(1, 0, 2).reshape(arm["away"].shape[1], -1)[::stride]
    told: dict[str, Any] = {name: _limits(bootstrap(arm[name], median, np.random.default_rng(0))) for name in MEASURES}
    for limit in WITHIN_M:
        name = f"within_{1000 * limit:g}_mm_s"
        told[name.replace("_s", "_share")] = _limits(
            bootstrap(np.isfinite(arm[name]).astype(float), mean, np.random.default_rng(0)))
    quartiles = np.quantile(curve, [0.25, 0.5, 0.75], axis=1)
    return told | {"cpu_s_a_tick": float(arm["cpu_s"].mean()), "curve_m": quartiles.tolist(),
                   "final_m_by_seed": np.median(arm["final_m"], axis=1).tolist(), "stride": stride}


def _against(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Share of goals at which the first is better (ties count half), and by how much, paired by goal."""
    import numpy as np

    from pipeline.statistics.bootstrap import bootstrap, mean, median

    told: dict[str, Any] = {}
    for name in MEASURES:
        a, b = first[name], second[name]
        wins = np.where(a < b, 1.0, np.where(a == b, 0.5, 0.0))
        told[name] = {"better": _limits(bootstrap(wins, mean, np.random.default_rng(0)))}
        if np.isfinite(a).all() and np.isfinite(b).all():
            told[name]["more_by"] = _limits(bootstrap(a - b, median, np.random.default_rng(0)))
    return told


def _limits(interval: Any) -> dict[str, float | None]:
    from math import isfinite

    return {key: value if isfinite(value := getattr(interval, key)) else None for key in ("estimate", "low", "high")}
