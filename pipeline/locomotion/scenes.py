"""Scenes of legged robots: starts as the gate, the exam and work draw them, each family with seeds of its own."""

from collections.abc import Sequence

import numpy as np

from pipeline.errors import SimulationError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.starts import Start, as_data, draw_start, from_data, pushed
from pipeline.locomotion.tasks import load_legged_task
from pipeline.simulation.tasks import mixed
from schemas.legged import LeggedStart
from schemas.scene import SceneFamily, SceneSpec

HARD = "hard"
"""Kind of start that was harvested where a robot fell, rather than drawn."""
SCENE = "ground"


def legged_scene(task_name: str, body_name: str, family: SceneFamily, seed: int, stratum: str,
                 twin: int | None = None) -> SceneSpec:
    """The start that this seed (see pipeline.simulation.tasks.scene_seed) gives in this stratum of the task."""
    return legged_scenes(task_name, body_name, family, [(seed, stratum)], twin)[0]


def legged_scenes(task_name: str, body_name: str, family: SceneFamily, drawn: Sequence[tuple[int, str]],
                  twin: int | None = None) -> list[SceneSpec]:
    """One scene for each seed and stratum; the body is built once for all."""
    task, body = load_legged_task(task_name), load_legged(body_name)
    return [_scene(task_name, body_name, family, seed, stratum, twin, draw_start(task, body, stratum, seed))
            for seed, stratum in drawn]


def hard_scene(task_name: str, body_name: str, family: SceneFamily, seed: int, start: LeggedStart,
               twin: int | None = None) -> SceneSpec:
    """An attempt that begins where another robot stood before it fell; the seed draws what will push it."""
    return _scene(task_name, body_name, family, seed, HARD, twin,
                  pushed(from_data(start), load_legged_task(task_name), seed))


def starts_of(scenes: Sequence[SceneSpec], body: LeggedBody) -> list[Start]:
    """How the attempts of these scenes begin.

    Raises:
        SimulationError: a scene has no legged start, or one of another robot.
    """
    starts: list[Start] = []
    for scene in scenes:
        if scene.legged is None:
            raise SimulationError(f"scene of robot {scene.robot!r} has no legged start", where=f"scene {scene.seed}",
                                  mend="draw it by pipeline.locomotion.scenes.legged_scene")
        if len(scene.legged.bend) != len(body.joints):
            raise SimulationError(f"start of {len(scene.legged.bend)} joints, the robot has {len(body.joints)}",
                                  where=f"scene {scene.seed} of robot {scene.robot!r}",
                                  mend=f"give the body that it was drawn for: {scene.robot}")
        starts.append(from_data(scene.legged))
    return starts


def mixed_legged(task_name: str, n: int, rare_share: float, rng: np.random.Generator) -> list[str]:
    """Kinds of n starts in random order, as pipeline.simulation.tasks.mixed_strata draws those of the arm."""
    task = load_legged_task(task_name)
    return mixed(task.common, task.rare, n, rare_share, rng)


def _scene(task: str, body: str, family: SceneFamily, seed: int, stratum: str, twin: int | None,
           start: Start) -> SceneSpec:
    return SceneSpec(family=family, seed=seed, robot=body, scene=SCENE, task=task, stratum=stratum,
                     object_xy_m=(0, 0), object_yaw_rad=0, object_half_m=0, target_xy_m=(0, 0), twin=twin,
                     legged=as_data(start))
