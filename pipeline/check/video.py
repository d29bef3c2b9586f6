"""Pictures against rows: as many as there should be, and of the same moment."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.check.following import Fit, best_lag, resample
from pipeline.check.motion import followed
from pipeline.check.own_time import told_missing
from pipeline.check.projection import tool_track
from pipeline.check.signals import Camera, Rows, Signals, Subject
from schemas.contract import Contract
from schemas.finding import Finding

EVEN = 0.7
"""Share of steps like the usual one from which on a camera has a rate."""
MANY = 16
"""Pictures from which on their number, and their fit to the joints, says something."""


def frames(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """Pictures and messages against the rows or ticks that they belong to."""
    for signals in subject.recordings:
        yield from _ticks(signals)
        if subject.tables is None:
            for camera in signals.cameras.values():
                yield from _holes(signals, camera, contract)
    if subject.tables is not None:
        lengths = dict(zip(subject.tables.episodes["episode_index"], subject.tables.episodes["length"], strict=True))
        for (camera, index), count in sorted(subject.tables.videos.items()):
            if count != lengths[index]:
                yield Finding(check="frames", what=f"{count} pictures for {lengths[index]} rows",
                              where=f"episode {index} {camera}", value=float(count), limit=float(lengths[index]),
                              mend="build the dataset again from its recordings; an encoder dropped pictures")


def _ticks(signals: Signals) -> Iterator[Finding]:
    """Topics that speak once a tick, against the ticks that the recording promises."""
    if signals.episode is None or signals.faults.get("truncated"):
        return
    promised = signals.episode.frames
    for name, topic in signals.topics.items():
        if topic.sequence is None or topic.tabled or len(topic) < MANY or not _every_tick(topic.sequence):
            continue
        if len(topic) + (told_missing(signals, name) if name in signals.cameras else 0) != promised:
            yield Finding(check="frames", what=f"{len(topic)} messages for {promised} ticks", where=name,
                          value=float(len(topic)), limit=float(promised),
                          mend="drop the episode, or record it again with a longer queue")


def _every_tick(sequence: NDArray[np.int64]) -> bool:
    return np.count_nonzero(np.diff(sequence) == 1) > 0.8 * (len(sequence) - 1)


def _holes(signals: Signals, camera: Camera, contract: Contract) -> Iterator[Finding]:
    """Pictures that a camera left out, by its running number; by its stamps where it has none."""
    if len(camera.stamps_ns) < MANY:
        return
    topic = signals.topics.get(camera.name)
    numbers = topic.sequence if topic is not None else None
    steps = np.diff(camera.stamps_ns if numbers is None or not numbers.any() else numbers).astype(np.float64)
    usual = float(np.median(steps))
    if not usual > 0 or np.mean(np.abs(steps - usual) < 0.5 * usual) < EVEN:
        return
    missing = int(np.round(steps / usual - 1).clip(min=0).sum())
    limit = max(1.0, contract.thresholds.frames_share * len(camera.stamps_ns))
    told = 0 < missing <= told_missing(signals, camera.name)
    few = told and missing <= contract.thresholds.told_share * (len(steps) + 1 + missing)
    if missing > limit or told:
        k = int(steps.argmax())
        yield Finding(check="frames", severity="warning" if few else "error",
                      what=f"{missing} of {len(steps) + 1 + missing} pictures are missing"
                      + (", as the recorder counted" if told else ""), where=camera.name,
                      at_s=signals.at_s(int(camera.stamps_ns[k])), frame=k, value=float(missing), limit=limit,
                      mend="look at the recorder's dropped messages; lower the camera's size or rate")


def shifted_video(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """Pictures that move when the robot does not: motion in the picture against motion of the tool, or of the joints.

    Roots of both are compared, so that the few pictures in which the whole arm swings do not decide alone.
    """
    limits = contract.thresholds
    moving = _moving(signals, contract)
    if moving is None:
        return
    stamps_ns, speed, period_s = moving
    for name, camera in signals.cameras.items():
        both = (_fit(camera, part, stamps_ns, speed, period_s, contract) for part in (slice(None), _changing(camera)))
        for fit, period in filter(None, both):
            if fit.correlation >= max(limits.lag_correlation, fit.within + limits.video_gain) \
                    and abs(fit.lag_s) > limits.video_shift_s:
                side = "behind" if fit.lag_s > 0 else "ahead of"
                yield Finding(check="shifted-video", what=f"pictures run {abs(fit.lag_s):.3g} s {side} the joints "
                              f"({abs(fit.lag_s) / period:.0f} frames)", where=name, value=fit.lag_s,
                              limit=limits.video_shift_s,
                              mend="stamp pictures when they are exposed, and align rows by stamps, not by number")
                break


def _fit(camera: Camera, part: slice, stamps_ns: NDArray[np.int64], speed: Rows, period_s: float,
         contract: Contract) -> tuple[Fit, float] | None:
    """Where a part of a camera's pictures fits the motion best, and the period of the clock for the comparison [s]."""
    zero, shift = int(stamps_ns[0]), contract.thresholds.video_shift_s
    own, energy, stamps = (stamps_ns - zero) / 1e9, camera.energy()[part], (camera.stamps_ns[part] - zero) / 1e9
    if len(energy) < MANY or not energy.any():
        return None
    period = max(period_s, float(np.median(np.diff(stamps))))
    clock = np.arange(max(own[0], stamps[0]), min(own[-1], stamps[-1]), period, dtype=np.float64)
    if len(clock) < MANY:
        return None
    fit = best_lag(resample(own, np.sqrt(speed)[:, None], clock), resample(stamps, np.sqrt(energy)[:, None], clock),
                   period, allowed_s=(-shift, shift))
    return None if fit is None else (fit, period)


def _changing(camera: Camera) -> slice:
    """The pictures without those at both ends that only repeat one: a shifted video may be filled up so."""
    new = np.array([a != b for a, b in pairwise(camera.prints)], np.bool_)
    at = np.flatnonzero(new)
    return slice(int(at[0]), int(at[-1]) + 2) if at.size else slice(0, 0)


def _moving(signals: Signals, contract: Contract) -> tuple[NDArray[np.int64], Rows, float] | None:
    """Stamps [ns], speed and period [s] of the tool where it is recorded, else of all joints of the first pair."""
    track = tool_track(signals)
    if track is not None and len(track[0]) >= MANY:
        steps = np.linalg.norm(np.diff(track[1], axis=0, prepend=track[1][:1]), axis=1)
        return track[0], steps, float(np.median(np.diff(track[0]))) / 1e9
    for both in followed(signals, contract):
        if both.pair.kind == "target":
            stamps = both.topic.log_ns if both.topic.header_ns is None else both.topic.header_ns
            speed = np.abs(np.diff(both.measured, axis=0, prepend=both.measured[:1])).sum(axis=1)
            return int(stamps[0]) + np.round(both.clock_s * 1e9).astype(np.int64), speed, both.period_s
    return None
