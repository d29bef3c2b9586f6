"""Cameras that show nothing, stand still, or are mistaken for each other."""

from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.check.motion import followed, unit_of
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


def black_camera(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Pictures that show nothing, or do not decode."""
    limits = contract.thresholds
    for name, camera in signals.cameras.items():
        if not len(camera.thumbs):
            continue
        flat = camera.thumbs.reshape(len(camera.thumbs), -1)
        dark = (flat.mean(axis=1) < limits.black_grey) & (flat.std(axis=1) < 2 * limits.flat_grey)
        blank = dark | (flat.std(axis=1) < limits.flat_grey / 4)
        if blank.any():
            k = int(np.argmax(blank))
            yield Finding(check="black-camera", what=f"{int(blank.sum())} of {len(flat)} pictures show nothing",
                          where=name, at_s=signals.at_s(int(camera.stamps_ns[k])), frame=k, value=float(flat[k].mean()),
                          limit=limits.black_grey, mend="look at the camera's cable, lid and exposure; drop the episode")
        if camera.broken:
            yield Finding(check="black-camera", what=f"{camera.broken} of {len(flat)} pictures do not decode", where=name,
                          value=float(camera.broken), limit=0.0, mend="record JPEG or PNG; look at the driver")


def frozen_camera(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """The same picture to the bit, again and again, while the robot moves."""
    limits = contract.thresholds
    motion = _joints(signals, contract)
    if motion is None:
        return
    for name, camera in signals.cameras.items():
        start = 0
        for k in range(1, len(camera.prints) + 1):
            if k < len(camera.prints) and camera.prints[k] == camera.prints[start]:
                continue
            span_s = (int(camera.stamps_ns[k - 1]) - int(camera.stamps_ns[start])) / 1e9
            inside = (motion[0] >= camera.stamps_ns[start]) & (motion[0] <= camera.stamps_ns[k - 1])
            moved = float(np.ptp(motion[1][inside], axis=0).max()) if inside.any() else 0.0
            if span_s >= limits.frozen_camera_s and moved >= limits.camera_motion_rad:
                yield Finding(check="frozen-camera", what=f"the same picture for {span_s:.3g} s while a joint moves by "
                              f"{moved:.3g}", where=name, at_s=signals.at_s(int(camera.stamps_ns[start])), frame=start,
                              value=span_s, limit=limits.frozen_camera_s,
                              mend="restart the camera's driver; drop the episode")
                break
            start = k


def _joints(signals: Signals, contract: Contract) -> tuple[np.ndarray, Rows] | None:
    """Stamps [ns] and positions of every measured joint that turns."""
    for pair in contract.motion:
        found = signals.find(pair.measured)
        if pair.kind == "target" and found is not None and len(found[0]) > 1:
            turning = [k for k, n in enumerate(found[2].names) if unit_of(n, contract, pair.measured) == "rad"]
            if turning:
                topic = found[0]
                stamps = topic.log_ns if topic.header_ns is None else topic.header_ns
                return stamps, np.nan_to_num(found[2].rows[:, turning])
    return None


def swapped_cameras(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """A camera that shows what another one should: by its picture in the contract, by the rest of the dataset, by its
    own beginning, or by how much of its picture moves with the robot."""
    common = {name: _unhex(rule.fingerprint) for name, rule in contract.cameras.items() if rule.fingerprint}
    if not common and len(subject.recordings) > 2:
        names = {n for s in subject.recordings for n, c in s.cameras.items() if len(c.thumbs)}
        common = {n: np.median([picture(s.cameras[n].thumbs) for s in subject.recordings if n in s.cameras], axis=0)
                  for n in names}
    for signals in subject.recordings:
        finding = _swapped(signals, contract, common) or _swapped_on_the_way(signals, contract) \
            or _swapped_by_motion(signals, contract)
        if finding is not None:
            yield finding


def picture(thumbs: Pictures) -> Rows:
    """The median of a camera's pictures, shape (12, 16): what does not move is seen as it is."""
    return np.median(thumbs, axis=0)


def fingerprint(camera: Camera) -> str:
    """The median picture in hex, as a contract holds it."""
    return picture(camera.thumbs).astype(np.uint8).tobytes().hex()


def _unhex(text: str) -> Rows:
    return np.frombuffer(bytes.fromhex(text), np.uint8).reshape(THUMB[1], THUMB[0]).astype(np.float64)


def _alike(one: Rows, other: Rows) -> float:
    """Correlation of two pictures, -1 to 1: brightness and contrast do not count."""
    a, b = one.ravel() - one.mean(), other.ravel() - other.mean()
    scale = float(np.sqrt((a ** 2).sum() * (b ** 2).sum()))
    return float((a * b).sum()) / scale if scale > 0 else 0.0


def _exchanged(shown: Mapping[str, Rows], known: Mapping[str, Rows], margin: float) -> tuple[str, str, float] | None:
    """Two cameras, each of which looks more like the other one, and by how much."""
    names = sorted(set(shown) & set(known))
    for k, a in enumerate(names):
        for b in names[k + 1:]:
            gain = min(_alike(shown[a], known[b]) - _alike(shown[a], known[a]),
                       _alike(shown[b], known[a]) - _alike(shown[b], known[b]))
            if gain > margin:
                return a, b, gain
    return None


def _swapped(signals: Signals, contract: Contract, known: Mapping[str, Rows]) -> Finding | None:
    shown = {n: picture(c.thumbs) for n, c in signals.cameras.items() if len(c.thumbs)}
    found = _exchanged(shown, known, contract.thresholds.swap_margin)
    return _told(signals, contract, found, None) if found else None


def _swapped_on_the_way(signals: Signals, contract: Contract) -> Finding | None:
    parts = {n: np.array_split(c.thumbs, WINDOWS) for n, c in signals.cameras.items() if len(c.thumbs) >= 2 * WINDOWS}
    first = {n: picture(p[0]) for n, p in parts.items()}
    for k in range(1, WINDOWS):
        found = _exchanged({n: picture(p[k]) for n, p in parts.items()}, first, contract.thresholds.swap_margin)
        if found:
            camera = signals.cameras[found[0]]
            row = sum(len(part) for part in parts[found[0]][:k])
            return _told(signals, contract, found, signals.at_s(int(camera.stamps_ns[row])))
    return None


def _swapped_by_motion(signals: Signals, contract: Contract) -> Finding | None:
    """A camera on the robot sees nearly all of its picture change; one at the scene sees the arm pass by."""
    shares = {n: _moving_share(c.thumbs) for n, c in signals.cameras.items() if len(c.thumbs) > 8}
    on_robot = [n for n in shares if any(part in n.lower() for part in ON_ROBOT)]
    at_scene = [n for n in shares if any(part in n.lower() for part in AT_SCENE) and n not in on_robot]
    for a in on_robot:
        for b in at_scene:
            if shares[b] > 0.3 and shares[b] > 2 * shares[a]:
                return _told(signals, contract, (a, b, shares[b] - shares[a]), None)
    return None


def _moving_share(thumbs: Pictures) -> float:
    """Share of pixels whose grey value changes over the recording by more than noise."""
    low, high = np.quantile(thumbs, [0.1, 0.9], axis=0)
    return float(np.mean(high - low > CHANGED_GREY))


def _told(signals: Signals, contract: Contract, found: tuple[str, str, float], at_s: float | None) -> Finding:
    a, b, gain = found
    return Finding(check="swapped-cameras", what=f"{a} shows what {b} should, and the other way round",
                   where=signals.name, at_s=at_s, value=gain, limit=contract.thresholds.swap_margin,
                   mend="exchange the two cameras' topics or plugs; make the contract anew if they were moved on purpose")
