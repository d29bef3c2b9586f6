"""Read any MCAP log in a stream: messages in file order, in batches, every CRC checked, memory flat."""

import stat
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.logs.attached import read_attachments, read_metadata
from pipeline.logs.batch import Batch, Channel, Kind, Problem, Problems
from pipeline.logs.bounds import look_through
from pipeline.logs.declared import Declared
from pipeline.logs.section import Piece, Section
from pipeline.logs.source import Source
from pipeline.logs.summary import Proof, check_summary
from pipeline.logs.walk import groups
from pipeline.recording.errors import DAMAGED, ends_early, reading, refuse
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD

__all__ = ["Batch", "Channel", "Kind", "LogReader", "Problem", "open_log"]

LATEST_NS = (1 << 63) - 1
"""Latest time that is told apart, in the year 2262 [ns]."""


@contextmanager
def open_log(path: Path, *, accept_truncated: bool = False) -> Generator["LogReader"]:
    """Open an MCAP log of any writer.

    Args:
        path: the file.
        accept_truncated: end at the first damage or missing byte with a problem, instead of raising.

    Raises:
        RecordingError: it cannot be opened, or is no regular file.
    """
    with reading(path, "file"):
        status = path.stat()
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise refuse("not a regular file", path, "name a .mcap recording")
        stream = FileIO(path)
    with stream:
        yield LogReader(stream, path, status.st_size, accept_truncated=accept_truncated)


class LogReader:
    """An open log. Batches come as the file is read: what was read before an error is sound, and not all."""

    def __init__(self, stream: FileIO, path: Path, size: int, *, accept_truncated: bool) -> None:
        self.path, self.size = path, size
        self.counts: dict[int, int] = {}
        """Channel number -> messages read so far, unwanted ones too."""
        self.channels: dict[int, Channel] = {}
        """Channels declared so far."""
        self.attached: list[tuple[str, int]] = []
        """Name and size [B] of attachments read so far, of the first 10,000."""
        self._stream, self._tolerant = stream, accept_truncated
        self._problems = Problems()
        self._source: Source | None = None
        self._metadata: list[tuple[str, dict[str, str]]] | None = None

    @property
    def position(self) -> int:
        """Bytes of the file that were read so far."""
        return self._source.offset if self._source is not None else 0

    @property
    def problems(self) -> list[Problem]:
        """What was wrong or odd and did not keep the log from being read; complete once all batches were read."""
        return self._problems.all()

    def batches(self, wanted: Callable[[Channel], bool] | None = None) -> Iterator[Batch]:
        """All messages of the wanted channels, in file order; reads the file once more at every call.

        Args:
            wanted: asked once a channel; the messages of the others are only counted and checked.

        Raises:
            RecordingError: damaged, hostile, cut off (unless that was accepted) or not MCAP.
        """
        self._problems, source = Problems(), Source(self._stream, self.size)
        self._source = source
        declared = Declared(self._problems)
        section = Section(source, declared, self._problems, self.path, tolerant=self._tolerant)
        self.channels, self.counts, self.attached = declared.channels, section.tally.counts, section.attached
        asked: dict[int, bool] = {}
        with reading(self.path, "file"):
            look_through(self._stream, self.size, self.path)
            for piece in section.pieces():
                yield from self._split(piece, asked, wanted)
            self._finish(source, section, declared)
        self._metadata = section.metadata

    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Metadata records of the data section: name and strings."""
        return read_metadata(self._stream, self.size, self.path) if self._metadata is None else self._metadata

    def attachments(self) -> Iterator[tuple[str, str, bytes]]:
        """Name, media type and content of every attachment, each with its CRC checked."""
        return read_attachments(self._stream, self.size, self.path)

    def _split(self, piece: Piece, asked: dict[int, bool],
               wanted: Callable[[Channel], bool] | None) -> Iterator[Batch]:
        order, parts = groups(piece.heads["channel"])
        for number, first, stop in parts:
            if number not in self.channels:
                raise refuse(f"messages on channel {number}, which was never declared", self.path, DAMAGED)
            self.counts[number] = self.counts.get(number, 0) + stop - first
            if number not in asked:
                asked[number] = wanted is None or wanted(self.channels[number])
        if not any(asked[number] for number, _, _ in parts):
            return
        heads, starts = piece.heads, piece.starts
        if order is not None:
            heads, starts = heads[order], starts[order]
        starts = starts + MESSAGE_HEAD.size
        sizes = heads["length"].astype(np.int64) - MESSAGE_FIELDS
        sequence = heads["sequence"].astype(np.uint32)
        log_ns, publish_ns = self._times(heads["log"]), self._times(heads["publish"])
        for number, a, b in parts:
            if asked[number]:
                yield Batch(self.channels[number], piece.data, starts[a:b], sizes[a:b], log_ns[a:b], publish_ns[a:b],
                            sequence[a:b])

    def _times(self, field: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Times as int64; those beyond it at its end, and told."""
        times = field.astype(np.int64)
        if (times < 0).any():
            self._problems.add(f"time beyond 2^63 ns; read as {LATEST_NS}", 0, "odd")
            times[times < 0] = LATEST_NS
        return times

    def _finish(self, source: Source, section: Section, declared: Declared) -> None:
        tally = section.tally
        if section.end is not None:
            if not self._tolerant:
                raise ends_early(tally.messages, tally.seconds, self.path)
            self._problems.add(f"ends early after message {tally.messages} (t = {tally.seconds:.2f} s): {section.end}",
                               source.offset, "damage")
            self._unproven_data(section)
            return
        proof = check_summary(source, declared, tally, self._problems)
        if not section.crc:
            self._unproven(section, declared, proof)

    def _unproven(self, section: Section, declared: Declared, proof: Proof) -> None:
        """Note what no CRC proves in a file without one over all of its data."""
        tally = section.tally
        self._unproven_data(section)
        if not (proof.counts and proof.places):
            self._problems.add("no CRC over the data and no sound summary: missing data would not be seen", 0,
                               "unproven")
        confirmed = proof.crc and proof.declarations >= declared.schemas + len(declared.channels)
        if tally.metadata or (declared.outside and not confirmed):
            self._problems.add("metadata or channels without a CRC: damage would not be seen", 0, "unproven")

    def _unproven_data(self, section: Section) -> None:
        if section.tally.bare:
            self._problems.add("chunks, messages or attachments without a CRC: damage would not be seen", 0, "unproven")
