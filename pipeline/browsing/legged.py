"""From the recording of a legged robot to what is drawn of it: the robot on its ground, its balance, its joints."""

from collections.abc import Mapping

import numpy as np

from pipeline.browsing.attempts import about, by_joint, segments, title
from pipeline.browsing.shown import Body, Shape, Shown, changes
from pipeline.browsing.urdf import read_urdf
from pipeline.trace import Rows, Trace
from schemas.episode import Episode

GROUND = Shape("box", (2.0, 2.0, 0.005), (0.0, 0.0, -0.005), colour=(204, 194, 178, 255))
"""A piece of the ground about the start [m]."""


def of_legged(episode: Episode, trace: Trace, attached: Mapping[str, bytes], *, seconds: Rows) -> Shown:
    """Everything that a recording of a legged robot holds, but its pictures.

    Args:
        episode: the record.
        trace: what happened.
        attached: the recording's files; robot.urdf gives shapes.
        seconds: when each tick was, from the start.
    """
    lines = by_joint(trace.joints, trace.joint_position, "state")
    if not trace.torque:
        lines |= by_joint(trace.joints, trace.joint_action, "command")
    for k, name in enumerate(trace.joints):
        lines |= {f"action/{name}/sent": trace.action[:, k], f"velocity/{name}": trace.joint_velocity[:, k],
                  f"effort/{name}": trace.joint_effort[:, k]}
    w, x, y, z = trace.imu[:, :4].T
    lines["balance/lean"] = np.arccos(np.clip(w * w - x * x - y * y + z * z, -1, 1))
    lines |= {f"balance/turning {axis}": trace.imu[:, 4 + k] for k, axis in enumerate("xyz")}
    lines |= {f"rewards/{term}": value for term, value in trace.reward.items()}
    lines |= {f"signals/{name}/{name}": value for name, value in trace.signals.items()}
    urdf = read_urdf(attached["robot.urdf"], episode.id) if "robot.urdf" in attached else None
    bodies = [Body("ground", (GROUND,), np.array([[0.0, 0, 0, 1, 0, 0, 0]]))] if trace.links else []
    bodies += [Body(link, urdf.links[link], trace.link_poses[:, k])
               for k, link in enumerate(trace.links) if urdf is not None and urdf.links.get(link)]
    path = trace.link_poses[:, 0, :3] if trace.links else np.zeros((0, 3))
    states = {"phase": changes(trace.phase)} if any(trace.phase) else {}
    return Shown(title(episode), seconds, lines, tuple(bodies), path, states | segments(episode), trace.events,
                 facts=about(episode))
