"""From what is stored of an attempt to what is drawn of it: recordings, variants, ingested frames."""

import re
from collections.abc import Iterable, Mapping

import numpy as np

from pipeline.browsing.shown import Body, Shown, changes, even
from pipeline.browsing.surroundings import cube, perceived, surroundings
from pipeline.browsing.urdf import Urdf, poses, read_urdf, yawed
from pipeline.frames import ACTION, JOINTS, Frames, Table
from pipeline.trace import Rows, Trace
from schemas.episode import Episode

MEASURED, COMMANDED = ("x", "y", "z", "yaw"), ("x", "y", "z", "yaw")


def of_trace(episode: Episode, trace: Trace, attached: Mapping[str, bytes], *, seconds: Rows | None = None) -> Shown:
    """Everything that a recording of the reference arm holds, but its pictures.

    Args:
        episode: the record; its scene says where the target is.
        trace: what happened.
        attached: the recording's files; robot.urdf gives shapes, scene.xml the surroundings.
        seconds: when each tick was, from the start; by the clock of the control where None.
    """
    frames, xml = trace.frames(), attached.get("scene.xml")
    lines = _lines(frames)
    for k, name in enumerate((*JOINTS, "gripper")):
        for kind, values in (("velocity", trace.joint_velocity), ("effort", trace.joint_effort)):
            if np.isfinite(values[:, k]).all():
                lines[f"{kind}/{name}"] = values[:, k]
    lines |= {f"rewards/{term}": value for term, value in trace.reward.items()}
    lines |= {f"signals/{name}/{name}": value for name, value in trace.signals.items()}
    bodies = surroundings(episode.scene, xml)
    if trace.links:
        bodies += _recorded(episode, trace, attached)
    elif "robot.urdf" in attached:
        bodies += _robot(read_urdf(attached["robot.urdf"], episode.id), frames)
    if episode.scene.object_half_m:
        bodies.append(perceived(trace.environment, episode.scene.object_half_m))
    states = {"phase": changes(trace.phase)} if any(trace.phase) else {}
    return Shown(title(episode), even(len(trace), trace.hz) if seconds is None else seconds, lines, tuple(bodies),
                 trace.state[:, 7:10], states | segments(episode), trace.events, facts=about(episode))


def of_frames(episode: Episode, frames: Frames, attached: Mapping[str, bytes]) -> Shown:
    """A variant, of which only the dataset's features are stored; the robot moves as its joints were measured.

    Args:
        episode: the record.
        frames: its features.
        attached: robot.urdf and scene.xml of the recording that it was made from.
    """
    xml = attached.get("scene.xml")
    bodies = surroundings(episode.scene, xml)
    if "robot.urdf" in attached:
        bodies += _robot(read_urdf(attached["robot.urdf"], episode.id), frames)
    seen = frames.environment.astype(np.float64)
    place = np.concatenate([seen[:, :3], yawed(seen[:, 3])], axis=1)
    bodies.append(Body("object", cube(episode.scene, xml), place))
    return Shown(title(episode), even(len(frames), episode.control_hz), _lines(frames), tuple(bodies),
                 frames.state[:, 7:10].astype(np.float64), segments(episode), facts=about(episode))


def of_table(episode: Episode, table: Table) -> Shown:
    """Frames of any robot: every value against time, states and actions of one name in one plot."""
    columns = table.columns()
    lines: dict[str, Rows] = {}
    measured = set(table.names.get("observation.state", ()))
    for feature, names in table.names.items():
        for k, name in enumerate(names):
            lines[_place(feature, name, measured)] = columns[feature][:, k].astype(np.float64)
    return Shown(title(episode), even(len(table), episode.control_hz), lines, states=segments(episode),
                 facts=about(episode))


def segments(episode: Episode) -> dict[str, dict[int, str]]:
    """The lane of who commanded when."""
    return {"who": {s.start: f"{s.kind} ({s.actor})" for s in episode.segments}}


def about(episode: Episode) -> str:
    """What the record says, as Markdown."""
    outcome, scene = episode.outcome, episode.scene
    told = {
        "trigger": outcome.trigger, "reason": outcome.reason, "judged by": outcome.judged_by,
        "source": episode.origin, "generation": str(episode.generation), "policy": episode.policy,
        "parent": episode.parent, "made by": episode.transform, "task": scene.task, "robot": scene.robot,
        "start": scene.stratum, "frames": f"{episode.frames} at {episode.control_hz:g} Hz", "consent": episode.consent,
        "drawn physics": ", ".join(f"{d.name} {d.value:.3g} {d.unit}" for d in scene.draws),
    }
    after = " after" if outcome.label == "success" else ":"  # a correction succeeds where another attempt failed
    head = f"### {outcome.label}" + (f"{after} {outcome.family}" if outcome.family else "")
    facts = " · ".join(f"{name} **{_plain(value)}**" for name, value in told.items() if value)
    return f"{head}\n\nepisode **{episode.id}** · {facts}"


def by_joint(columns: Iterable[str], values: Rows, kind: str) -> dict[str, Rows]:
    """Curves 'joints/NAME/KIND' of the columns of `values`, shape (m, len(columns))."""
    return {f"joints/{name}/{kind}": values[:, k] for k, name in enumerate(columns)}


def _lines(frames: Frames) -> dict[str, Rows]:
    state = frames.state.astype(np.float64)
    lines = by_joint((*JOINTS, "gripper"), state, "state")
    lines |= by_joint((*JOINTS, "gripper"), frames.joint_action.astype(np.float64), "command")
    lines |= {f"hand/{name}/state": state[:, 7 + k] for k, name in enumerate(MEASURED)}
    lines |= {f"hand/{name}/command": state[:, 11 + k] for k, name in enumerate(COMMANDED)}
    lines |= {f"action/{name}/sent": frames.action[:, k].astype(np.float64) for k, name in enumerate(ACTION)}
    return lines


def _recorded(episode: Episode, trace: Trace, attached: Mapping[str, bytes]) -> list[Body]:
    urdf = read_urdf(attached["robot.urdf"], episode.id) if "robot.urdf" in attached else Urdf({}, ())
    shapes = dict(urdf.links) | {"object": cube(episode.scene, attached.get("scene.xml"))}
    return [Body(link, shapes[link], trace.link_poses[:, k])
            for k, link in enumerate(trace.links) if shapes.get(link)]


def _robot(urdf: Urdf, frames: Frames) -> list[Body]:
    values = {name: frames.state[:, k].astype(np.float64) for k, name in enumerate(JOINTS)}
    half = frames.state[:, 6].astype(np.float64) / 2  # the opening is the sum of two fingers' travel
    values |= {joint.name: half for joint in urdf.joints if joint.kind == "prismatic"}
    found = poses(urdf, values)
    return [Body(link, shapes, found[link]) for link, shapes in urdf.links.items() if shapes and link in found]


def _place(feature: str, name: str, measured: set[str]) -> str:
    plain = name.replace("/", ".")
    if feature == "observation.state":
        return f"joints/{plain}/state"
    if feature == "action" and name in measured:
        return f"joints/{plain}/command"
    return f"{feature.replace('/', '.')}/{plain}"


def title(episode: Episode) -> str:
    """Where an attempt comes from, which it is, and how it ended."""
    outcome = episode.outcome.family or episode.outcome.label
    return f"{episode.origin} {episode.id[:8]}: {outcome}"


def _plain(value: str) -> str:
    """Text of others without Markdown's own signs."""
    return re.sub(r"([*_`\[\]<>#|\\])", r"\\\1", value.replace("\n", " "))
