"""Harvest a legged robot: falls become hard cases, and what was sensed before each becomes a start for others."""

from collections.abc import Sequence

import numpy as np

from pipeline.errors import ConfigError
from pipeline.files import short_id
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.hard import ROWS, start_before
from pipeline.locomotion.odometry import LegOdometry
from pipeline.trace import Trace
from schemas.episode import Episode
from schemas.hardcase import HardCase

type Attempt = tuple[Episode, Trace]


def harvest_legged(attempts: Sequence[Attempt], *, before_s: float, generation: int,
                   arm: str = "") -> list[HardCase]:
    """A hard case for every deployed attempt that a trigger stopped, with the start that it gives.

    Args:
        attempts: deployed attempts of one robot with their recordings, as pipeline.recording.read_episode reads them.
        before_s: how long before the trigger the start lies; the attempt's own start where it fell sooner [s].
        generation: lap of the loop.
        arm: name of the arm of a study; its hard cases are its own.

    Raises:
        ConfigError: an attempt is not one of a legged robot, or of another one than it says.
    """
    failed = [(e, t) for e, t in attempts if e.outcome.label == "failure"]
    if not failed:
        return []
    robot = failed[0][0].scene.robot
    for episode, _ in failed:
        if episode.scene.legged is None or episode.scene.robot != robot:
            raise ConfigError(f"an attempt of robot {episode.scene.robot!r} among those of legged robots", where=
                              f"episode {episode.id}", mend="harvest the arm by stages.harvest, each robot by itself")
    body = load_legged(robot)
    for episode, trace in failed:
        if trace.joints != body.joints:
            raise ConfigError(f"recording of {len(trace.joints)} joints, {robot} has {len(body.joints)}",
                              where=f"episode {episode.id}", mend=f"harvest it with the robot that it was made with: "
                              f"its joints are {', '.join(trace.joints) or 'those of the arm'}")
    legs = LegOdometry(body, ROWS)
    made: list[HardCase] = []
    for episode, trace in failed:
        tick = episode.outcome.tick or 0
        begins = max(0, tick - int(np.ceil(before_s * trace.hz)))
        made.append(HardCase(
            id=short_id("hard case", episode.id, arm), episode=episode.id, trigger=episode.outcome.trigger or "",
            tick=tick, family=episode.outcome.family or "", stratum=episode.scene.stratum, generation=generation,
            begins=begins, start=start_before(trace.state, begins, body, legs)))
    return made
