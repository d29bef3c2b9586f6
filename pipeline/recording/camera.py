"""Pictures of a camera in a recording: which one each frame shows, and the pictures themselves, chunk by chunk."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.footage import Picture, decode, repeats, shown, source_of
from pipeline.recording import cdr
from pipeline.recording.errors import reading
from pipeline.recording.fields import Chunk
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD
from pipeline.recording.scan import Scan, load, scan, unpack
from pipeline.recording.series import Walk

TICKS = "/joint_states"
"""Its messages say when each tick was perceived."""
FILM = "record it with the camera (hardcase record --camera, hardcase teleop --camera), film it again (hardcase " \
       "film), or leave the episode or the camera out: dataset.cameras"


class RecordedFootage:
    """What a camera of a recording saw; see pipeline.footage.Footage.

    Frame k shows the newest picture that was recorded for a tick up to k: a picture says by its sequence number
    which tick came next when it was taken. A frame without a picture of its own shows the one before once more, as
    long as that is not older than `max_skew_s`; what comes later is never shown earlier.

    Args:
        path: a whole recording.
        camera: its name.
        frames: of the episode.
        blob: hash of the recording.
        max_skew_s: how old a picture may be [s].

    Raises:
        DatasetError: no picture of this camera, none yet at the first frame, or none that is new enough; names the
            frame.
        RecordingError: the recording is damaged.
    """

    def __init__(self, path: Path, camera: str, frames: int, *, blob: str, max_skew_s: float) -> None:
        self._path, self._topic = path, f"/camera/{camera}/image/compressed"
        where = f"{path.name}, {self._topic}"
        self._where, taken, perceived_ns = where, list[tuple[int, int, int, int]](), np.zeros(frames, np.int64)
        for number, topic, at, plain in _messages(scan(load(path), path), {self._topic, TICKS}):
            _, _, _, tick, _, publish_ns = MESSAGE_HEAD.unpack_from(plain, at)
            if topic == self._topic:
                taken.append((tick, publish_ns, number, at))
            elif tick < frames:
                perceived_ns[tick] = publish_ns
        if not taken:
            raise DatasetError(f"the recording has no picture of camera {camera!r}", where=where, mend=FILM)
        table = np.array(taken, np.int64)
        table = table[np.argsort(table[:, 0], kind="stable")]
        self._places = table[:, 2:]
        self._uses = np.searchsorted(table[:, 0], np.arange(frames), "right") - 1
        if self._uses[0] < 0:
            raise DatasetError(f"the first picture of camera {camera!r} belongs to tick {table[0, 0]}, "
                               "frame 0 has none", where=where, mend=FILM)
        self._skew_ns = perceived_ns - table[self._uses, 1]
        if (old := np.flatnonzero(self._skew_ns > round(max_skew_s * 1e9))).size:
            k = int(old[0])
            raise DatasetError(f"frame {k} would show a picture of camera {camera!r} that is "
                               f"{self._skew_ns[k] / 1e9:.3g} s old, allowed are {max_skew_s:g} s", where=where,
                               mend=f"raise dataset.cameras.{camera}.max_skew_s, or {FILM}")
        self.source = source_of(f"{blob} {camera}", self._uses)
        self.repeated = repeats(self._uses)

    @property
    def skew_s(self) -> NDArray[np.float32]:
        """See Footage."""
        return (self._skew_ns / 1e9).astype(np.float32)

    def pictures(self) -> Iterator[Picture]:
        """See Footage; one chunk of the recording is in memory at a time."""
        found, opened, plain = scan(load(self._path), self._path), -1, b""

        def picture(number: int) -> Picture:
            nonlocal opened, plain
            chunk, at = int(self._places[number, 0]), int(self._places[number, 1])
            if chunk != opened:
                opened, plain = chunk, unpack(found.chunks[chunk], found)
            where = f"{self._where}, picture {number}"
            return decode(_jpeg_of(plain, at, self._path, where), where)

        return shown(self._uses.tolist(), picture)


def _messages(found: Scan, topics: set[str]) -> Iterator[tuple[int, str, int, bytes]]:
    """Number of its chunk, topic, place in the unpacked chunk and that chunk, of every message of some topics."""
    walk = Walk(lambda _: True)
    for number, chunk in enumerate(found.chunks):
        yield from ((number, *rest) for rest in _of_chunk(walk, chunk, found, topics))


def _of_chunk(walk: Walk, chunk: Chunk, found: Scan, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
    plain = unpack(chunk, found)
    with reading(found.where, f"chunk at byte {chunk.offset}"):
        walk.chunk(plain, 0)
        places = {walk.channels[channel][0]: list(starts) for channel, starts in walk.starts.items()}
    walk.starts.clear()
    for topic in sorted(topics & places.keys()):
        for at in places[topic]:
            yield topic, at, plain


def _jpeg_of(plain: bytes, at: int, path: Path, where: str) -> bytes:
    _, length, *_ = MESSAGE_HEAD.unpack_from(plain, at)
    start = at + MESSAGE_HEAD.size
    payload = plain[start:start + length - MESSAGE_FIELDS]
    with reading(path, where):
        cursor = cdr.Cursor(payload)
        stamp_ns, frame, kind, size = cursor.stamp(), cursor.text(), cursor.text(), cursor.u32()
        if len(cdr.compressed_image(stamp_ns, frame, kind, b"")) + size != len(payload):
            raise ValueError(f"{size} B of a picture in a message of {len(payload)} B")
    return payload[len(payload) - size:]
