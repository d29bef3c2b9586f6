"""Layers: recordings of the same id as an episode's, laid over it: labels, shadow policies, predictions."""
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from pipeline.arrow import pa
from pipeline.browsing.episode import curve, recording, times
from pipeline.frames import ACTION, JOINTS
from pipeline.protocols import Array
from pipeline.trace import Rows, Shadow
from schemas.episode import Episode

PROPERTY = "episode"
"""Name of the property that the columns belong to."""
COLUMNS = ("outcome", "success", "source", "family", "generation", "start", "seconds", "task", "trigger", "policy",
           "parent", "robot", "note")
"""What the table of episodes is sorted, filtered and asked by."""
FAILED = (248, 113, 113)
TEXTS = frozenset(COLUMNS) - {"success", "generation", "seconds"}


def labels(path: Path, episode: Episode, note: str = "") -> None:
    """What is said of an episode: columns of the catalog, and a mark where a trigger fired.

    A layer of its own, because labels change and recordings do not.

    Args:
        path: where to write.
        episode: the record.
        note: what else there is to know, as 'corrected by 3f9a1c2b'.
    """
    with recording(path, episode.id) as stream:
        stream.send_recording_name(f"{episode.origin} {episode.id}")
        stream.send_property(PROPERTY, rr.AnyValues(drop_untyped_nones=False, **columns(episode, note)))
        tick = episode.outcome.tick
        if tick is not None and tick < episode.frames:
            label = episode.outcome.family or episode.outcome.trigger or episode.outcome.label
            seconds = np.arange(episode.frames) / episode.control_hz
            at = times(seconds, np.array([0, tick]))
            stream.log("/states/label", rr.StateConfiguration(values=[label], colors=[FAILED]), static=True)
            stream.send_columns("/states/label", at, rr.StateChange.columns(state=["", label]))


def columns(episode: Episode, note: str = "") -> dict[str, Any]:
    """Column -> its value as an Arrow array of one; null where there is nothing to say."""
    outcome = episode.outcome
    success = {"success": True, "failure": False}.get(outcome.label)
    values: dict[str, tuple[object, Any]] = {
        "outcome": (outcome.label, pa.string()), "success": (success, pa.bool_()),
        "source": (episode.origin, pa.string()), "family": (outcome.family, pa.string()),
        "trigger": (outcome.trigger, pa.string()), "task": (episode.scene.task, pa.string()),
        "robot": (episode.scene.robot, pa.string()), "start": (episode.scene.stratum, pa.string()),
        "generation": (episode.generation, pa.int64()), "policy": (episode.policy, pa.string()),
        "parent": (episode.parent, pa.string()), "seconds": (episode.duration_s, pa.float64()),
        "note": (note or None, pa.string()),
    }
    return {name: pa.array([value], kind) for name, (value, kind) in values.items()}


def shadows(path: Path, episode: str, seconds: Rows, watched: Mapping[str, Shadow]) -> None:
    """What policies that may not act would have done: a further curve in every joint's plot, and how far they differ.

    Args:
        path: where to write.
        episode: its id.
        seconds: when each tick was, shape (m,).
        watched: policy -> what it asked for.
    """
    with recording(path, episode) as stream:
        at = times(seconds)
        for policy, shadow in watched.items():
            for k, joint in enumerate((*JOINTS, "gripper")):
                curve(stream, f"joints/{joint}/shadow {policy[:8]}", at, shadow.joint_commands[:, k])
            curve(stream, f"shadow/{policy[:8]}", at, shadow.disagreement)


def predictions(path: Path, episode: str, seconds: Rows, state: Rows, chunks: Array) -> None:
    """What a policy would do, seeing what was recorded: the next action beside the one that was sent, and the way on.

    Args:
        path: where to write.
        episode: its id.
        seconds: when each tick was, shape (m,).
        state: see pipeline.frames.STATE, shape (m, 16).
        chunks: actions that it sees coming, shape (m, chunk, 5); see pipeline.frames.ACTION.
    """
    with recording(path, episode) as stream:
        at = times(seconds)
        for k, name in enumerate(ACTION):
            curve(stream, f"action/{name}/predicted", at, chunks[:, 0, k])
        ahead = state[:, None, 11:14] + np.cumsum(chunks[:, :, :3], axis=1)
        ways = np.concatenate([state[:, None, 7:10], ahead], axis=1)
        stream.log("/world/predicted", rr.LineStrips3D.from_fields(colors=[(192, 132, 252)], radii=0.002),
                   static=True)
        stream.send_columns("/world/predicted", at, rr.LineStrips3D.columns(strips=list(ways)))
