"""`hardcase measure odometry`: how far a hard start lies from where the robot truly stood, and whether that matters."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from flows.studies.measured import write_json
from pipeline.errors import ConfigError, PolicyError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.played import played
from pipeline.locomotion.robots import LeggedRobots
from pipeline.locomotion.scenes import hard_scene, legged_scenes
from pipeline.locomotion.starts import as_data
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.world import rotated, up_of
from pipeline.ppo.policy import LeggedPolicy
from pipeline.recording import read_episode
from pipeline.simulation.tasks import scene_seed
from pipeline.statistics.proportions import wilson
from pipeline.twin.legged import draw_legged_twin, twin_robots
from schemas.hardcase import HardCase
from schemas.legged import LeggedStart
from schemas.recipe import DeployConfig, Recipe
from schemas.scene import SceneSpec
from stages.deploy_legged import deploy_legged
from stages.harvest_legged import Attempt, harvest_legged

BEFORE_S = 0.6
ERRORS: Mapping[str, str] = MappingProxyType({
    "height": "m", "lean": "rad", "speed over ground": "m/s", "speed over ground, if taken as asked": "m/s",
    "speed upward": "m/s", "turning": "rad/s", "joints": "rad", "joint speeds": "rad/s"})
"""What a start says -> its unit; joints and their speeds as means over the joints."""


def run_odometry_study(policy: Path, *, twins: Sequence[int], episodes: int, task: str, json: Path | None,
                       threads: int = 1) -> dict[str, Any]:
    """Let a policy work on twins, compare the starts that its falls gave with the truth, print, hand back everything.

    Args:
        policy: policy.onnx, or the folder of a training.
        twins: seeds of the twins.
        episodes: attempts on each.
        task: what it is to do.
        json: where to write all of it.
        threads: threads of the engine.
    """
    driver = LeggedPolicy(policy / "policy.onnx" if policy.is_dir() else policy)
    if driver.body is None:
        raise PolicyError("the file does not say which robot it is for", where=policy,
                          mend="name the folder of a training: hardcase rl train --body biped --task stand")
    recipe = Recipe(name="odometry", robot=driver.body, scene="ground", task=task, threads=threads,
                    deploy=DeployConfig(episodes=episodes))
    apart: list[Mapping[str, float]] = []
    noticed = np.zeros(3, np.int64)
    falls = {kind: [0, 0] for kind in ("as sensed", "as it truly stood", "drawn as ever")}
    for twin in track(twins, description="twins", transient=True):
        attempts, truth = _deployed(driver, recipe, twin)
        said = np.array([e.outcome.label == "failure" for e, _ in attempts])
        noticed += [int((said & ~truth).sum()), int((said & truth).sum()), int((~said & ~truth).sum())]
        if not (cases := harvest_legged(attempts, before_s=BEFORE_S, generation=0)):
            continue
        true = _truth(cases, attempts, twin)
        apart += [_apart(case.start, start) for case, start in zip(cases, true, strict=True) if case.start]
        for kind, scenes in _scenes(recipe, cases, true, twin).items():
            falls[kind][0] += int((~_stood(driver, scenes, threads)).sum())
            falls[kind][1] += len(scenes)
    if not apart:
        raise ConfigError(f"it did not fall in any of {episodes * len(twins)} attempts", where=policy,
                          mend="more attempts, other twins, or a policy that is not so good: --episodes 300")
    found = {"cases": len(apart), "twins": list(twins), "episodes": episodes, "task": task, "robot": driver.body,
             "noticed": dict(zip(("rightly", "wrongly", "missed"), noticed.tolist(), strict=True)),
             "errors": {name: np.quantile([a[name] for a in apart], (0.5, 0.9)).tolist() for name in ERRORS},
             "rms": {name: float(np.sqrt(np.mean([a[name] ** 2 for a in apart]))) for name in ERRORS},
             "falls": {kind: wilson(*counts).model_dump() for kind, counts in falls.items()}}
    _show(found)
    write_json(json, found)
    return found


def _deployed(driver: LeggedPolicy, recipe: Recipe, twin: int) -> tuple[list[Attempt], NDArray[np.bool_]]:
    """Attempts, and which of them truly stayed on their feet."""
    with TemporaryDirectory() as folder:
        done = deploy_legged(driver, "0" * 16, recipe, seed=0, twin=twin, generation=0, folder=Path(folder),
                             software={})
        return [read_episode(r.path) for r in done.recorded], done.truth


def _truth(cases: Sequence[HardCase], attempts: Sequence[Attempt], twin: int) -> list[LeggedStart]:
    """Where each robot truly stood at the tick that its start was sensed at: restored from the recording."""
    by_id = {e.id: (e, t) for e, t in attempts}
    chosen = [(*by_id[c.episode], c.begins or 0) for c in cases]
    robots = twin_robots(draw_legged_twin(twin), [e.scene for e, _, _ in chosen], threads=1)
    ids = np.arange(robots.n)
    engine, rest = (np.stack([getattr(t, name)[k] for _, t, k in chosen]) for name in ("sim_state", "controller"))
    robots.load(ids, engine, rest)
    return [as_data(start) for start in robots.world.as_starts(ids)]


def _apart(sensed: LeggedStart, true: LeggedStart) -> dict[str, float]:
    """Error of each part of a start; a heading, which nobody senses, does not count."""
    up_sensed, up_true = (up_of(np.array([s.quaternion]))[0] for s in (sensed, true))
    went = np.array(true.velocity[:3])
    level = rotated(sensed.quaternion, rotated(true.quaternion, went, back=True))
    error, said = np.abs(level - np.array(sensed.velocity[:3])), np.array(sensed.command[:2])
    return {"height": abs(sensed.height_m - true.height_m),
            "lean": float(np.arccos(np.clip(up_sensed @ up_true, -1, 1))),
            "speed over ground": float(np.hypot(*error[:2])),
            "speed over ground, if taken as asked": float(np.hypot(*(level[:2] - said))),
            "speed upward": float(error[2]),
            "turning": float(np.linalg.norm(np.subtract(sensed.velocity[3:], true.velocity[3:]))),
            "joints": float(np.abs(np.subtract(sensed.bend, true.bend)).mean()),
            "joint speeds": float(np.abs(np.subtract(sensed.rates, true.rates)).mean())}


def _scenes(recipe: Recipe, cases: Sequence[HardCase], true: Sequence[LeggedStart],
            twin: int) -> dict[str, list[SceneSpec]]:
    """The same attempts three times: from what was sensed, from the truth, and from starts as they are drawn."""
    seeds = [scene_seed("study", twin, k) for k in range(len(cases))]
    kinds = load_legged_task(recipe.task).common
    drawn = [(seed, kinds[k % len(kinds)]) for k, seed in enumerate(seeds)]
    return {
        "as sensed": [hard_scene(recipe.task, recipe.robot, "study", seed, case.start)
                      for seed, case in zip(seeds, cases, strict=True) if case.start],
        "as it truly stood": [hard_scene(recipe.task, recipe.robot, "study", seed, start)
                              for seed, start in zip(seeds, true, strict=True)],
        "drawn as ever": legged_scenes(recipe.task, recipe.robot, "study", drawn)}


def _stood(driver: LeggedPolicy, scenes: Sequence[SceneSpec], threads: int) -> NDArray[np.bool_]:
    """Which attempts of the nominal robot did not fall."""
    robots = LeggedRobots(load_legged(scenes[0].robot), load_legged_task(scenes[0].task), scenes, threads=threads)
    return played(driver, robots).success


def _show(found: Mapping[str, Any]) -> None:
    errors = Table("what a start says", "unit", "median", "90 %", "rms")
    for name, unit in ERRORS.items():
        errors.add_row(name, unit, *(f"{v:.3f}" for v in (*found["errors"][name], found["rms"][name])))
    falls = Table("attempts of the nominal robot from", "falls", "of")
    for kind, share in found["falls"].items():
        falls.add_row(kind, f"{share['rate']:.3f} [{share['low']:.3f} {share['high']:.3f}]", str(share["n"]))
    console = Console(width=120)
    console.print(f"{found['robot']} {found['task']}: {found['cases']} falls on twins {found['twins']}, starts "
                  f"{BEFORE_S:g} s before; falls noticed "
                  + ", ".join(f"{how} {n}" for how, n in found["noticed"].items()))
    console.print(errors)
    console.print(falls)
