"""Where a camera should see the tool move: its pose from the recorded scene, against where its picture changes."""

from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from pipeline.check.following import correlation, numbers, resample
from pipeline.check.signals import Camera, Rows, Signals

MAX_SCENE = 16 << 20
TOOL = ("ee_x", "ee_y", "ee_z")
"""Columns with the tool's position in the world [m]."""
ENOUGH = 12
"""Pictures with motion in them below which nothing is told."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A camera that stands still in the world; it looks along its own -z, x to the right, y up, as in MuJoCo."""

    position_m: Rows
    """Shape (3,)."""
    rotation: Rows
    """Columns are the camera's axes in the world, shape (3, 3)."""

    def seen(self, points_m: Rows) -> Rows:
        """Where points appear, right and down of the middle, in units of the focal length, shape (n, 3) -> (n, 2)."""
        own = (points_m - self.position_m) @ self.rotation
        depth = np.maximum(-own[:, 2], 1e-6)
        return np.column_stack([own[:, 0] / depth, -own[:, 1] / depth])


def scene_poses(scene: bytes) -> dict[str, Pose]:
    """Camera name -> pose, of the cameras of an MJCF that stand in the world itself; none where it is no MJCF."""
    if not scene or len(scene) > MAX_SCENE or b"<!DOCTYPE" in scene or b"<!ENTITY" in scene:
        return {}
    try:
        root = ET.fromstring(scene)  # without a document type there is nothing to expand
        world = root.find("worldbody")
        cameras = [] if world is None else world.findall("camera")
        return {str(c.get("name")): Pose(_numbers(c.get("pos", "0 0 0"), 3), _rotation(c)) for c in cameras
                if c.get("mode", "fixed") == "fixed"}
    except (ET.ParseError, ValueError):
        return {}


def _numbers(text: str, count: int) -> Rows:
    values = np.array([float(x) for x in text.split()])
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(text[:80])
    return values


def _rotation(camera: ET.Element) -> Rows:
    """From quat (w, x, y, z) or xyaxes; other notations are those of hand-written files and say nothing here."""
    if (axes := camera.get("xyaxes")) is not None:
        both = _numbers(axes, 6)
        x = both[:3] / np.linalg.norm(both[:3])
        y = both[3:] - x * float(x @ both[3:])
        y = y / np.linalg.norm(y)
        return np.array([x, y, np.cross(x, y)], np.float64).T
    w, x, y, z = _numbers(camera.get("quat", "1 0 0 0"), 4)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def tool_track(signals: Signals) -> tuple[NDArray[np.int64], Rows] | None:
    """Stamps [ns] and positions [m] of the tool, where some topic has them."""
    for _, topic, column in signals.numbers():
        if set(TOOL) <= set(column.names) and len(topic) > 1:
            places = [column.names.index(name) for name in TOOL]
            return topic.log_ns if topic.header_ns is None else topic.header_ns, numbers(column.rows[:, places])
    return None


def fits(camera: Camera, track: tuple[NDArray[np.int64], Rows], pose: Pose) -> float:
    """How well the place of change in a camera's pictures follows the tool as a camera at `pose` would see it.

    The weighted mean of the two correlations, sideways and up-down, weighted by how far the tool moves that way;
    0 where too little moves.
    """
    change = camera.changes()
    weight = np.where(change > change.mean() + change.std(), change, 0.0)
    total = weight.sum(axis=(1, 2))
    moving = total > 0.2 * total.mean() if total.any() else np.zeros(len(total), bool)
    if moving.sum() < ENOUGH:
        return 0.0
    weight, total = weight[moving], total[moving]
    rows, columns = np.arange(change.shape[1]), np.arange(change.shape[2])
    place = np.column_stack([(weight.sum(axis=1) @ columns) / total, (weight.sum(axis=2) @ rows) / total])
    zero = int(track[0][0])
    clock = (camera.stamps_ns[1:][moving] - zero) / 1e9
    seen = pose.seen(resample((track[0] - zero) / 1e9, track[1], clock))
    spread = seen.std(axis=0)
    weights = [float(s) + 1e-9 for s in spread]
    return sum(w * correlation(place[:, k], seen[:, k]) for k, w in enumerate(weights)) / sum(weights)
