"""How much a log may ask for: bounds that grow with its size, and a look at what its chunks declare."""

import struct
from io import FileIO
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.logs.source import Source
from pipeline.recording.errors import SPLIT, refuse
from pipeline.recording.records import MAGIC, Op
from pipeline.recording.unpacking import MAX_BYTES

MAX_PLAIN, PLAIN_A_BYTE = 128 << 20, 200
"""All chunks of a log together, unpacked [B]: for a small log, and what each byte of the file adds to it."""
MAX_RECORDS, BYTES_A_RECORD = 500_000, 64
"""Records other than messages: for a small log, and how many bytes of the file allow one more. The smallest
chunk and its index together take about 150."""
SMALL = 8 << 20
"""Files up to this size are looked through before anything is unpacked [B]; of a larger one the bound lies so far
away that the limits of the child are met first."""
_HOSTILE = f"do not open it elsewhere, it may be made to fill memory; if it is right, {SPLIT}"


class Bounds:
    """What is left of both bounds while a log is read."""

    def __init__(self, size: int, where: Path) -> None:
        self._where = where
        self._most_plain, self._most_records = MAX_PLAIN + PLAIN_A_BYTE * size, MAX_RECORDS + size // BYTES_A_RECORD
        self._plain, self._records = self._most_plain, self._most_records

    def unpack(self, size: int, offset: int) -> None:
        """Count a chunk; RecordingError where all of them together declare too much."""
        self._plain -= size
        if self._plain < 0:
            raise refuse(f"chunks up to byte {offset} declare more than {self._most_plain} B together", self._where,
                         _HOSTILE)

    def record(self, offset: int) -> None:
        """Count a record that is no message; RecordingError where there are too many."""
        self._records -= 1
        if self._records < 0:
            raise too_many(self._most_records, offset, self._where)


def too_many(most: int, offset: int, where: Path) -> RecordingError:
    """The error for a file of countless records."""
    return refuse(f"more than {most} records up to byte {offset}", where, _HOSTILE)


def look_through(stream: FileIO, size: int, where: Path) -> None:
    """Add up what the chunks of a small file declare, without unpacking one.

    Damage is not looked for here: the look ends where it stands in the way.

    Raises:
        RecordingError: the chunks declare more together than such a file may hold.
    """
    if size > SMALL:
        return
    source, bounds = Source(stream, size), Bounds(size, where)
    if not source.fill(len(MAGIC)):
        return
    source.at = len(MAGIC)
    for _ in range(MAX_RECORDS):
        if not source.fill(9 + 24):
            return
        op, length = struct.unpack_from("<BQ", source.data, source.at)
        if op == Op.CHUNK:
            (plain,) = struct.unpack_from("<Q", source.data, source.at + 9 + 16)
            bounds.unpack(min(plain, MAX_BYTES), source.offset)  # one that is too large is told by name later
        if not source.jump(9 + length):
            return
