"""Record while it happens: any robot, any rate, cameras on; the control thread never waits for the disk."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import RecordingError
from pipeline.files import sync_folder
from pipeline.recording import cdr
from pipeline.recording.live_file import LiveFile
from pipeline.recording.live_header import START, segments_of, start_metadata
from pipeline.recording.live_part import checked_topic, open_part, steady_clock, stopped
from pipeline.recording.live_rows import Row, RowLayout, TickLayout, Vector
from pipeline.recording.live_writer import QUEUE_BYTES, Body, Item, LiveWriter, close_quietly, write_all
from pipeline.recording.metadata import NAME, episode_metadata
from pipeline.recording.pictures import check_jpeg, check_picture, image_message
from pipeline.recording.verify import verify
from pipeline.recording.write import RESERVE_BYTES, named, part_of
from schemas.consent import Consent
from schemas.episode import Episode, Outcome, Segment

_OVERHEAD = 200
"""What a message takes in the queue besides its numbers [B]."""


@dataclass(frozen=True, slots=True)
class Closed:
    """A recording that was read again as a whole and has its name."""

    path: Path
    episode: Episode
    """With the file's sha256 as its blob."""
    dropped: Mapping[str, int]
    """Topic -> messages that were lost because the disk was slower than the robot; "tick" counts whole ticks."""


class LiveRecorder:
    """Records one attempt into NAME.mcap.part, which gets its name in `close`; implements protocols.Recorder.

    Every method but `close` only queues: it takes some microseconds and returns False where the message was
    dropped, because the queue is full or the disk has failed (`failed` says so at once, `close` raises it). What
    a killed process had written is kept by pipeline.recording.recover. Methods may be called from any thread,
    one topic from one thread at a time.

    Args:
        path: the final name, ending in .mcap.
        episode: what is known at the start; its frames, outcome and segments are those of `close`, and its one
            segment says who begins (see live_header.beginning).
        attachments: scene.xml, config.json, robot.urdf, randomization.json; the URDF also goes to /robot_description.
        software: software_commit, simulator_version and further strings for the metadata.
        consent: the record that the episode refers to, where a person is recorded.
        layout: messages of a tick, for a robot other than the reference arm; see live_rows.joint_layout.
        clock: log time now [ns]; wall time that goes on monotonically where None.
        queue_bytes: what may wait for the disk [B].
        reserve_bytes: free space below which no recording starts [B].

    Raises:
        RecordingError: the name is taken, left over or being written, or the disk is short or refuses.
    """

    def __init__(self, path: Path, episode: Episode, *, attachments: Mapping[str, bytes],
                 software: Mapping[str, str] | None = None, consent: Consent | None = None,
                 layout: TickLayout | None = None, clock: Callable[[], int] | None = None,
                 queue_bytes: int = QUEUE_BYTES,
                 reserve_bytes: int = RESERVE_BYTES) -> None:
        self.path, self.frames = path, 0
        self._episode, self._software, self._layout = episode, dict(software or {}), layout
        self._consent = consent
        self._clock, self._latest = clock or steady_clock(), 0
        self._topics, self._skipped = set[str](), dict[str, int]()
        self._numbered = self._closed = False
        first = episode.segments[0]
        self._starts: list[tuple[int, str, str]] = [(0, first.kind, first.actor)]
        with named(path):
            self._handle = open_part(path, reserve_bytes)
        try:
            with named(path):
                self._begin(attachments, queue_bytes)
        except BaseException:
            part_of(path).unlink(missing_ok=True)
            close_quietly(self._handle)
            raise

    def _begin(self, attachments: Mapping[str, bytes], queue_bytes: int) -> None:
        now = self.now()
        metadata = {START: start_metadata(self._episode, self._software, self._consent)}
        self._file = LiveFile(metadata, attachments, now)
        if (urdf := attachments.get("robot.urdf")) is not None:
            self._file.add("/robot_description", 0, now, now, cdr.text(urdf.decode()))
            self._file.seal()
        self._writer = LiveWriter(self._handle, self._file, self._lay, self.now, queue_bytes=queue_bytes)

    # -- while it happens -------------------------------------------------------------------------------------------

    def tick(self, tick: int, row: Row | Vector, *, stamp_ns: int | None = None) -> bool:
        """Record tick `tick`: all its messages, or none.

        Args:
            tick: 0, 1, 2, ...; the sequence number of its messages.
            row: what was perceived at the tick, and the action that followed; a vector where a layout was given.
            stamp_ns: when it was perceived [ns], on the robot's clock; now where None.
        """
        if isinstance(row, Row):
            if self._layout is None:
                self._layout = RowLayout(row, self.path)
            values, names = row.vector(), row.names
        else:
            values, names = np.array(row, np.float64), ()
        if self._layout is None or values.shape != self._layout.shape or names != self._layout.names:
            raise RecordingError(f"tick {tick} is laid out otherwise than the first", where=self.path,
                                 mend="give the same links, rewards and sizes at every tick; for a vector, a layout")
        if tick >= self.frames:
            self.frames = tick + 1
        now = self.now()
        return self._writer.put(Item("tick", tick, now, now if stamp_ns is None else stamp_ns, values),
                                values.nbytes + _OVERHEAD)

    def write(self, topic: str, payload: bytes, *, tick: int | None = None, stamp_ns: int | None = None) -> bool:
        """Record one message of a topic of the dialect.

        Args:
            topic: see dialect.TOPICS.
            payload: CDR, encapsulation included; see cdr.py.
            tick: its sequence number; the tick that comes next where None.
            stamp_ns: publish time [ns]; now where None.
        """
        if topic not in self._topics:
            self._topics.add(checked_topic(topic, self.path))
        return self._put(topic, payload, len(payload), tick, stamp_ns)

    def image(self, camera: str, picture: NDArray[np.uint8] | bytes, *, tick: int | None = None,
              stamp_ns: int | None = None) -> bool:
        """Record a picture on /camera/<camera>/image/compressed.

        Args:
            camera: its name.
            picture: RGB, shape (height, width, 3), or a JPEG. An array that can be written to is copied.
            tick: the tick it belongs to; the one that comes next where None.
            stamp_ns: when it was taken [ns]; now where None.
        """
        topic = f"/camera/{camera}/image/compressed"
        if isinstance(picture, bytes):
            check_jpeg(picture, topic)
            return self._put(topic, partial(image_message, camera, picture), len(picture), tick, stamp_ns, low=True)
        check_picture(picture, topic)
        if picture.flags.writeable:
            picture = picture.copy()
        return self._put(topic, picture, picture.nbytes, tick, stamp_ns, low=True)

    def phase(self, name: str, *, tick: int | None = None) -> bool:
        """Record that a subtask begins."""
        return self.write("/task/phase", cdr.text(name), tick=tick)

    def event(self, name: str, text: str, *, level: int = 20, tick: int | None = None) -> bool:
        """Record an event; level as in rcl_interfaces/msg/Log: 20 info, 30 warn, 40 error."""
        return self._put("/events", lambda ns: cdr.log(ns, level, name, text), len(text), tick, None)

    def joy(self, axes: list[float], buttons: list[int], *, tick: int | None = None,
            stamp_ns: int | None = None) -> bool:
        """Record raw operator input on /teleop/joy."""
        return self._put("/teleop/joy", lambda ns: cdr.joy(ns, axes, buttons), 8 * len(axes) + 8 * len(buttons), tick,
                         stamp_ns)

    def skipped(self, camera: str, count: int) -> None:
        """Note in the metadata how many pictures a camera should have taken and did not."""
        self._skipped[camera] = count

    def segment(self, kind: str, actor: str, *, tick: int | None = None) -> bool:
        """From `tick` (the next one where None) somebody else commands; kind and actor as in schemas Segment."""
        at = self.frames if tick is None else tick
        Segment.model_validate({"kind": kind, "start": at, "stop": at + 1, "actor": actor})
        self._starts = [s for s in self._starts if s[0] < at] + [(at, kind, actor)]
        return self.event("segment", f"{kind} {actor}", tick=at)

    def now(self) -> int:
        """Time on the recording's clock [ns]; it stands still where the clock underneath goes back."""
        self._latest = max(self._latest, self._clock())
        return self._latest

    @property
    def failed(self) -> bool:
        """Whether the disk has refused something; `close` tells what."""
        return self._writer.error is not None

    @property
    def dropped(self) -> dict[str, int]:
        """Topic -> messages that were lost so far."""
        return dict(self._writer.dropped)

    def _put(self, topic: str, body: Body, size: int, tick: int | None, stamp_ns: int | None, *,
             low: bool = False) -> bool:
        now = self.now()
        item = Item(topic, self.frames if tick is None else tick, now, now if stamp_ns is None else stamp_ns, body)
        return self._writer.put(item, size + _OVERHEAD, low=low)

    def _lay(self, item: Item) -> None:
        """Lay an item into the file, in the writer's thread: here the encoding is done."""
        topic, tick, log_ns, stamp_ns, body = item
        if topic == "tick":
            self._lay_tick(tick, log_ns, stamp_ns, cast(Vector, body))
            return
        if isinstance(body, np.ndarray):
            body = image_message(topic.split("/")[2], cast(NDArray[np.uint8], body), stamp_ns)
        self._file.add(topic, tick, log_ns, stamp_ns, body if isinstance(body, bytes) else body(stamp_ns))

    def _lay_tick(self, tick: int, log_ns: int, stamp_ns: int, values: Vector) -> None:
        layout = self._layout
        assert layout is not None
        if not self._numbered:
            layout.number([self._file.declare(topic) for topic in layout.topics])
            self._numbered = True
        self._file.add_block(layout.block(tick, log_ns, stamp_ns, values), layout.places, log_ns)

    # -- at the end -------------------------------------------------------------------------------------------------

    def close(self, outcome: Outcome | None = None, segments: tuple[Segment, ...] | None = None) -> Closed:
        """Finish the file: sync it, read all of it again, give it its name.

        Args:
            outcome: how the attempt ended; unknown where None.
            segments: who commanded when; those of `segment` where None.

        Raises:
            RecordingError: what the disk reported first, or the file does not read back; NAME.mcap.part stays
                for recover. Without a single tick the .part is removed.
        """
        if self._closed:
            raise RecordingError("recording is closed already", where=self.path, mend="start another one")
        self._stop()
        try:
            if self.frames == 0:
                part_of(self.path).unlink()
                raise RecordingError("no tick was recorded", where=self.path, mend="record at least one tick")
            with named(self.path):
                if self._writer.error is not None:
                    raise stopped(self._writer.error, self.path)
                return self._finish(outcome or Outcome(label="unknown", judged_by="operator"), segments)
        finally:
            close_quietly(self._handle)

    def abandon(self) -> None:
        """Write what waits and leave NAME.mcap.part as a killed process would: recover marks it truncated."""
        if not self._closed:
            self._stop()
            close_quietly(self._handle)

    def _stop(self) -> None:
        self._closed = True
        self._writer.finish()

    def _finish(self, outcome: Outcome, segments: tuple[Segment, ...] | None) -> Closed:
        if segments is None:
            segments = segments_of(self._starts, self.frames)
        values = self._episode.model_dump() | {"frames": self.frames, "outcome": outcome, "segments": segments}
        episode = Episode.model_validate(values)
        dropped = dict(self._writer.dropped)
        extra = {**self._software, "dropped": json.dumps(dropped, sort_keys=True),
                 "skipped": json.dumps(self._skipped, sort_keys=True)}
        self._file.end({NAME: episode_metadata(episode, software=extra, truncated=False, consent=self._consent)})
        write_all(self._handle, self._file.take())
        os.fsync(self._handle)
        part = part_of(self.path)
        digest = verify(part, self._file.assembly.counts, self._file.numbers)
        part.replace(self.path)
        sync_folder(self.path.parent)
        return Closed(self.path, episode.model_copy(update={"blob": digest}), dropped)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Leave the .part for recover, unless it was closed: whoever did not get to `close` knows no outcome."""
        self.abandon()
