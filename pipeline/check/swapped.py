"""Cameras that are mistaken for each other."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from pipeline.check.following import correlation
from pipeline.check.projection import fits, scene_poses, tool_track
from pipeline.check.signals import THUMB, Camera, Pictures, Rows, Signals, Subject
from schemas.contract import Contract
from schemas.finding import Finding

ON_ROBOT = ("wrist", "hand", "gripper", "eef", "eye")
AT_SCENE = ("front", "top", "scene", "base", "over", "side", "table", "room", "world", "third", "high", "low")
"""Parts of names that say where a camera sits."""
CHANGED_GREY = 6
"""Change of a pixel that is more than noise and compression [grey values]."""
WINDOWS = 4
"""Parts of a recording that are compared with its beginning, to find a swap on the way."""
FOLLOWS = 0.3
"""By how much better the pictures of both cameras must follow the tool as the other one would see it, in correlation;
clean ones follow it worse by 0.5 and more."""

type Exchange = tuple[str, str, float]
"""Two cameras, and by how much each of them looks more like the other one."""


def swapped_cameras(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """A camera that shows what another one should.

    Told by the frame that its pictures name; by its picture in the contract; by the rest of the dataset; by its own
    beginning; by where its pose in the recorded scene would see the tool; or by how much of its picture moves.
    """
    common = {name: _unhex(rule.fingerprint) for name, rule in contract.cameras.items() if rule.fingerprint}
    if not common and len(subject.recordings) > 2:
        common = _consensus(subject)
    ways: tuple[Callable[[Signals], tuple[Exchange, float | None] | None], ...] = (
        _by_frame, lambda s: _by_picture(s, common, contract), lambda s: _on_the_way(s, contract), _by_projection,
        _by_motion)
    for signals in subject.recordings:
        if len(signals.cameras) > 1:
            found = next((f for way in ways if (f := way(signals)) is not None), None)
            if found is not None:
                (a, b, gain), at_s = found
                yield Finding(check="swapped-cameras", what=f"{a} shows what {b} should, and the other way round",
                              where=signals.name, at_s=at_s, value=gain, limit=contract.thresholds.swap_margin,
                              mend="exchange the two cameras' topics or plugs; make the contract anew if they were "
                              "moved on purpose")


def picture(thumbs: Pictures) -> Rows:
    """The median of a camera's pictures, shape (12, 16): what does not move is seen as it is."""
    return np.median(thumbs, axis=0)


def fingerprint(camera: Camera) -> str:
    """The median picture in hex, as a contract holds it."""
    return picture(camera.thumbs).astype(np.uint8).tobytes().hex()


def _unhex(text: str) -> Rows:
    return np.frombuffer(bytes.fromhex(text), np.uint8).reshape(THUMB[1], THUMB[0]).astype(np.float64)


def _consensus(subject: Subject) -> dict[str, Rows]:
    """What each camera shows in most recordings."""
    shown: dict[str, list[Rows]] = {}
    for signals in subject.recordings:
        for name, camera in signals.cameras.items():
            if len(camera.thumbs):
                shown.setdefault(name, []).append(picture(camera.thumbs))
    return {name: np.median(pictures, axis=0) for name, pictures in shown.items()}


def _exchanged(shown: Mapping[str, Rows], known: Mapping[str, Rows], margin: float) -> Exchange | None:
    """Two cameras, each of which looks more like the other one."""
    names = sorted(set(shown) & set(known))
    for k, a in enumerate(names):
        for b in names[k + 1:]:
            gain = min(correlation(shown[a], known[b]) - correlation(shown[a], known[a]),
                       correlation(shown[b], known[a]) - correlation(shown[b], known[b]))
            if gain > margin:
                return a, b, gain
    return None


def _by_frame(signals: Signals) -> tuple[Exchange, None] | None:
    """Pictures whose header names the frame of another camera."""
    for a, camera in signals.cameras.items():
        for b in signals.cameras:
            parts = a.strip("/").split("/"), b.strip("/").split("/")
            if camera.frame and a != b and camera.frame in parts[1] and camera.frame not in parts[0]:
                return (a, b, 1.0), None
    return None


def _by_picture(signals: Signals, known: Mapping[str, Rows], contract: Contract) -> tuple[Exchange, None] | None:
    shown = {n: picture(c.thumbs) for n, c in signals.cameras.items() if len(c.thumbs)}
    found = _exchanged(shown, known, contract.thresholds.swap_margin)
    return (found, None) if found else None


def _on_the_way(signals: Signals, contract: Contract) -> tuple[Exchange, float] | None:
    parts = {n: np.array_split(c.thumbs, WINDOWS) for n, c in signals.cameras.items() if len(c.thumbs) >= 2 * WINDOWS}
    first = {n: picture(p[0]) for n, p in parts.items()}
    for k in range(1, WINDOWS):
        found = _exchanged({n: picture(p[k]) for n, p in parts.items()}, first, contract.thresholds.swap_margin)
        if found:
            row = sum(len(part) for part in parts[found[0]][:k])
            return found, signals.at_s(int(signals.cameras[found[0]].stamps_ns[row]))
    return None


def _by_projection(signals: Signals) -> tuple[Exchange, None] | None:
    """Where the pictures change, against where the tool would be seen from the pose of either camera."""
    poses, track = scene_poses(signals.attachments.get("scene.xml", b"")), tool_track(signals)
    if track is None or len(poses) < 2:
        return None
    own = {n: next((p for p in n.strip("/").split("/") if p in poses), "") for n in signals.cameras}
    names = [n for n, pose in own.items() if pose and len(signals.cameras[n].thumbs) > 1]
    score = {(n, m): fits(signals.cameras[n], track, poses[own[m]]) for n in names for m in names}
    for k, a in enumerate(names):
        for b in names[k + 1:]:
            gain = min(score[a, b] - score[a, a], score[b, a] - score[b, b])
            if gain > FOLLOWS and min(score[a, b], score[b, a]) > FOLLOWS / 2:
                return (a, b, gain), None
    return None


def _by_motion(signals: Signals) -> tuple[Exchange, None] | None:
    """A camera on the robot sees nearly all of its picture change; one at the scene sees the arm pass by."""
    shares = {n: _moving_share(c.thumbs) for n, c in signals.cameras.items() if len(c.thumbs) > 8}
    on_robot = [n for n in shares if any(part in n.lower() for part in ON_ROBOT)]
    at_scene = [n for n in shares if any(part in n.lower() for part in AT_SCENE) and n not in on_robot]
    for a in on_robot:
        for b in at_scene:
            if shares[b] > 0.3 and shares[b] > 2 * shares[a]:
                return (a, b, shares[b] - shares[a]), None
    return None


def _moving_share(thumbs: Pictures) -> float:
    """Share of pixels whose grey value changes over the recording by more than noise."""
    low, high = (np.quantile(thumbs, share, axis=0) for share in (0.1, 0.9))
    return float(np.count_nonzero(high - low > CHANGED_GREY)) / low.size
