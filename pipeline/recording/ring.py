"""A ring for live recordings: full rate around every trigger, decimated elsewhere, and nothing of it in memory alone.

One file, NAME.mcap, holds every tenth tick. Beside it two or three files record everything, each begun ten seconds
after the one before; the oldest is thrown away when the next is ten seconds old and nothing has happened. A trigger
keeps the oldest, which becomes NAME-window-00N.mcap five seconds after the last trigger in it. All of them are
recordings like any other: who is killed leaves .part files that pipeline.recording.recover makes whole.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.files import short_id
from pipeline.recording.live import Closed, LiveRecorder
from pipeline.recording.live_rows import Row, TickLayout, Vector
from pipeline.recording.pictures import check_picture, jpeg
from pipeline.recording.ring_lap import Lap, Ring, end, throw_away
from pipeline.recording.write import part_of
from schemas.consent import Consent
from schemas.episode import Episode, Outcome, Segment

AHEAD_S = 0.5
"""How long before it is needed a file is opened, off the control thread [s]."""
_RARE = ("/task/phase", "/events")
"""Topics that the decimated file has in full."""


class RingRecorder:
    """Takes the calls of a LiveRecorder, and `trigger`; like it, none of them but `close` waits for the disk.

    Args:
        path, episode, attachments, software, consent, layout, clock: see LiveRecorder.
        ring: what to keep.

    Raises:
        RecordingError: see LiveRecorder.
    """

    def __init__(self, path: Path, episode: Episode, *, attachments: Mapping[str, bytes], ring: Ring | None = None,
                 software: Mapping[str, str] | None = None, consent: Consent | None = None,
                 layout: TickLayout | None = None, clock: Callable[[], int] | None = None) -> None:
        self.path, self.frames, self._ring = path, 0, ring or Ring()
        self.windows: list[Closed] = []
        """Windows that are whole, in order; complete after `close`."""
        self._episode, hz = episode, episode.control_hz
        self._before, self._after = (round(s * hz) for s in (self._ring.before_s, self._ring.after_s))
        self._ahead, self._number, self._phase = round(AHEAD_S * hz), 0, ""
        self._party = (str(episode.segments[0].kind), episode.segments[0].actor)

        def start(path: Path, episode: Episode) -> LiveRecorder:
            return LiveRecorder(path, episode, attachments=attachments, software=software, consent=consent,
                                layout=deepcopy(layout), clock=clock)  # a layout knows its file's channels

        self._start, self._pool = start, ThreadPoolExecutor(1, thread_name_prefix="ring")
        thin = {"control_hz": hz / self._ring.every, "transform": f"one tick in {self._ring.every}"}
        self._thin = start(path, episode.model_copy(update=thin))
        self._endings: list[Future[Closed | None]] = []
        self._error: Exception | None = None
        self._next: Future[Lap] | None = None
        try:
            self._laps: tuple[Lap, ...] = (self._lap(),)
        except BaseException:
            self._thin.abandon()
            part_of(path).unlink(missing_ok=True)
            self._pool.shutdown()
            raise

    # -- while it happens -------------------------------------------------------------------------------------------

    def tick(self, tick: int, row: Row | Vector, *, stamp_ns: int | None = None) -> bool:
        """Record a tick in the files at full rate, and in the decimated one if it is its turn."""
        self.frames = max(self.frames, tick + 1)
        stamp_ns = self.now() if stamp_ns is None else stamp_ns
        self._turn(tick)
        taken = [lap.recorder.tick(tick - lap.first, row, stamp_ns=stamp_ns) for lap in self._laps]
        if tick % self._ring.every == 0:
            taken.append(self._thin.tick(tick // self._ring.every, row, stamp_ns=stamp_ns))
        return all(taken)

    def trigger(self, name: str, text: str, *, tick: int) -> bool:
        """Keep what happened before this tick, and what comes after it.

        Args:
            name: of the trigger, or whatever else makes the moment worth keeping.
            text: for /events.
            tick: when it fired.
        """
        told = self.event("trigger", text, level=30, tick=tick)
        kept = next((lap for lap in self._laps if lap.until is not None), self._laps[0])
        if kept.outcome is None:
            kept.outcome = Outcome(label="unknown", judged_by="sensors", trigger=name, tick=max(0, tick - kept.first),
                                   reason=f"window around {name}, from tick {kept.first} of {self._episode.id}")
        kept.until = tick + self._after
        return told

    def keep(self, *, tick: int) -> None:
        """Have the window that is open go on for as long after this tick as after a trigger."""
        for lap in self._laps:
            if lap.until is not None:
                lap.until = max(lap.until, tick + self._after)

    def write(self, topic: str, payload: bytes, *, tick: int | None = None, stamp_ns: int | None = None) -> bool:
        """Record one message; see LiveRecorder.write."""
        return self._all(lambda r, at: r.write(topic, payload, tick=at, stamp_ns=stamp_ns), tick,
                         always=topic in _RARE)

    def image(self, camera: str, picture: NDArray[np.uint8] | bytes, *, tick: int | None = None,
              stamp_ns: int | None = None) -> bool:
        """Record a picture; an array is made a JPEG once, here, for all files."""
        if not isinstance(picture, bytes):
            check_picture(picture, camera)
            picture = jpeg(picture)
        stamp_ns, data = self.now() if stamp_ns is None else stamp_ns, picture
        return self._all(lambda r, at: r.image(camera, data, tick=at, stamp_ns=stamp_ns), tick)

    def phase(self, name: str, *, tick: int | None = None) -> bool:
        """Record that a subtask begins."""
        self._phase = name
        return self._all(lambda r, at: r.phase(name, tick=at), tick, always=True)

    def event(self, name: str, text: str, *, level: int = 20, tick: int | None = None) -> bool:
        """Record an event; see LiveRecorder.event."""
        return self._all(lambda r, at: r.event(name, text, level=level, tick=at), tick, always=True)

    def joy(self, axes: list[float], buttons: list[int], *, tick: int | None = None,
            stamp_ns: int | None = None) -> bool:
        """Record raw operator input."""
        return self._all(lambda r, at: r.joy(axes, buttons, tick=at, stamp_ns=stamp_ns), tick)

    def segment(self, kind: str, actor: str, *, tick: int | None = None) -> bool:
        """From this tick on somebody else commands."""
        self._party = (kind, actor)
        return self._all(lambda r, at: r.segment(kind, actor, tick=at), tick, always=True)

    def skipped(self, camera: str, count: int) -> None:
        """Note how many pictures a camera should have taken and did not."""
        self._thin.skipped(camera, count)

    def now(self) -> int:
        """Time on the recording's clock [ns]."""
        return self._thin.now()

    @property
    def failed(self) -> bool:
        """Whether the disk has refused something; `close` tells what."""
        return self._error is not None or self._thin.failed or any(lap.recorder.failed for lap in self._laps)

    @property
    def opening(self) -> bool:
        """Whether the next file is still being opened; it takes milliseconds, and the control thread never waits."""
        return self._next is not None and not self._next.done()

    @property
    def dropped(self) -> dict[str, int]:
        """Topic -> messages that were lost so far in the files that are open."""
        found: dict[str, int] = {}
        for recorder in (self._thin, *(lap.recorder for lap in self._laps)):
            for topic, count in recorder.dropped.items():
                found[topic] = found.get(topic, 0) + count
        return found

    def _all(self, put: Callable[[LiveRecorder, int], bool], tick: int | None, *, always: bool = False) -> bool:
        """Hand a message to every file that has its tick; the decimated one takes it in its turn, or always."""
        at = self.frames if tick is None else tick
        taken = [put(lap.recorder, at - lap.first) for lap in self._laps if at >= lap.first]
        if always or at % self._ring.every == 0:
            taken.append(put(self._thin, at // self._ring.every))
        return all(taken)

    # -- laps -------------------------------------------------------------------------------------------------------

    def _lap(self) -> Lap:
        """Open the next file at full rate; runs off the control thread, but for the first."""
        self._number += 1
        path = self.path.with_name(f"{self.path.stem}-window-{self._number:03}.mcap")
        known = {"id": short_id("window", self._episode.id, self._number), "transform": f"window of {self._episode.id}"}
        return Lap(self._start(path, self._episode.model_copy(update=known)))

    def _turn(self, tick: int) -> None:
        """Begin a file when the newest is old enough, end windows, throw away what nobody needs any more."""
        age = tick - self._laps[-1].first
        if self._next is None and age >= self._before - self._ahead and self._error is None:
            self._next = self._pool.submit(self._lap)
        if age >= self._before and self._next is not None and self._next.done():
            try:
                self._begin(self._next.result(), tick)
            except Exception as error:
                self._error = error
            self._next = None
        old = [lap for lap in self._laps if tick - lap.first >= self._before]
        for lap in self._laps:
            over = lap in old[:-1] if lap.until is None else tick > lap.until
            if over and len(self._laps) > 1:
                self._end(lap)

    def _begin(self, lap: Lap, tick: int) -> None:
        lap.first = tick
        lap.recorder.event("window", f"from tick {tick} of {self._episode.id}", tick=0)
        if self._phase:
            lap.recorder.phase(self._phase, tick=0)
        first = self._episode.segments[0]
        if self._party != (str(first.kind), first.actor):
            lap.recorder.segment(*self._party, tick=0)
        self._laps = (*self._laps, lap)

    def _end(self, lap: Lap) -> None:
        """Close a window, or throw a file away in which nothing happened, off the control thread."""
        self._laps = tuple(other for other in self._laps if other is not lap)
        self._endings.append(self._pool.submit(end, lap))

    # -- at the end -------------------------------------------------------------------------------------------------

    def close(self, outcome: Outcome | None = None, segments: tuple[Segment, ...] | None = None) -> Closed:
        """Finish every file; the decimated one is handed back, the others are in `windows`.

        What a window shows is not the whole attempt, so its outcome is unknown, unless it reaches the end.

        Args:
            outcome: how it all ended.
            segments: who commanded when, in ticks of the decimated file; those of `segment` where None.

        Raises:
            RecordingError: see LiveRecorder.close; files that could not be finished stay for recover.
        """
        self._forget_next()
        for lap in self._laps:
            if lap.outcome is not None and outcome is not None:  # a window that reaches the end knows how it ended
                told = {"trigger": lap.outcome.trigger, "tick": lap.outcome.tick,
                        "reason": "; ".join(filter(None, (lap.outcome.reason, outcome.reason)))}
                lap.outcome = outcome.model_copy(update=told)
            self._end(lap)
        self._pool.shutdown()
        try:
            closed = self._thin.close(outcome, segments)
        finally:
            errors = [error for ending in self._endings if (error := ending.exception()) is not None]
            self.windows = [made for e in self._endings if e.exception() is None and (made := e.result()) is not None]
        if self._error or errors:
            raise self._error or errors[0]
        return closed

    def abandon(self) -> None:
        """Leave every .part as a killed process would: recover makes the last ten seconds and more of it a window."""
        self._forget_next()
        self._pool.shutdown()
        for recorder in (self._thin, *(lap.recorder for lap in self._laps)):
            recorder.abandon()

    def _forget_next(self) -> None:
        """Throw away the file that was opened ahead, if one was."""
        if self._next is not None:
            self._endings.append(self._pool.submit(throw_away, self._next))
            self._next = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.abandon()
