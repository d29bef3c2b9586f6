"""Cameras that show nothing, or stand still."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.check.following import numbers
from pipeline.check.motion import unit_of
from pipeline.check.signals import Rows, Signals
from schemas.contract import Contract
from schemas.finding import Finding

VIDEO = 2
"""How much longer, and squared how much further the robot must move, before a picture of a video counts as frozen: an
encoder shows the same picture again where little changes in it."""


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
                          where=name, at_s=signals.at_s(int(camera.stamps_ns[k])), frame=k,
                          value=float(flat[k].mean()), limit=limits.black_grey,
                          mend="look at the camera's cable, lid and exposure; drop the episode")
        if camera.broken:
            yield Finding(check="black-camera", what=f"{camera.broken} of {len(flat)} pictures do not decode",
                          where=name, value=float(camera.broken), limit=0.0,
                          mend="record JPEG or PNG; look at the driver")


def frozen_camera(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """The same picture to the bit, again and again, while the robot moves."""
    limits = contract.thresholds
    motion = _joints(signals, contract)
    if motion is None:
        return
    for name, camera in signals.cameras.items():
        start, longer = 0, VIDEO if camera.video else 1
        for k in range(1, len(camera.prints) + 1):
            if k < len(camera.prints) and camera.prints[k] == camera.prints[start]:
                continue
            span_s = (int(camera.stamps_ns[k - 1]) - int(camera.stamps_ns[start])) / 1e9
            inside = (motion[0] >= camera.stamps_ns[start]) & (motion[0] <= camera.stamps_ns[k - 1])
            moved = float(np.ptp(motion[1][inside], axis=0).max()) if inside.any() else 0.0
            if span_s >= longer * limits.frozen_camera_s and moved >= longer ** 2 * limits.camera_motion_rad:
                yield Finding(check="frozen-camera", what=f"the same picture for {span_s:.3g} s while a joint moves by "
                              f"{moved:.3g}", where=name, at_s=signals.at_s(int(camera.stamps_ns[start])), frame=start,
                              value=span_s, limit=limits.frozen_camera_s,
                              mend="restart the camera's driver; drop the episode")
                break
            start = k


def _joints(signals: Signals, contract: Contract) -> tuple[NDArray[np.int64], Rows] | None:
    """Stamps [ns] and positions of every measured joint that turns."""
    for pair in contract.motion:
        found = signals.find(pair.measured)
        if pair.kind == "target" and found is not None and len(found[0]) > 1:
            turning = [k for k, n in enumerate(found[2].names) if unit_of(n, contract, pair.measured) == "rad"]
            if turning:
                topic = found[0]
                stamps = topic.log_ns if topic.header_ns is None else topic.header_ns
                return stamps, numbers(found[2].rows[:, turning])
    return None
