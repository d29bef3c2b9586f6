"""What was seen of a log's data: to be counted against its summary."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.fields import Chunk

_MASK = (1 << 64) - 1


def place(offset: int, length: int, first_ns: int, last_ns: int, compression: str, packed: int, plain: int) -> int:
    """One number for what a chunk index says of a chunk; sums of them are equal for equal sets."""
    return hash((offset, length, first_ns, last_ns, compression, packed, plain)) & _MASK


@dataclass(slots=True)
class Tally:
    """Counts over the data section."""

    counts: dict[int, int] = field(default_factory=dict[int, int])
    """Channel number -> messages."""
    chunks: int = 0
    places: int = 0
    """Sum over place() of every chunk."""
    attachments: int = 0
    metadata: int = 0
    bare: int = 0
    """Chunks, messages and attachments without a CRC of their own."""
    range_ns: tuple[int, int] | None = None
    """Earliest and latest log time, 0 included."""
    first_set_ns: int | None = None
    """Earliest log time that is not 0: latched messages lie at 0."""

    @property
    def messages(self) -> int:
        """All messages."""
        return sum(self.counts.values())

    @property
    def seconds(self) -> float:
        """From the first to the last message that was not latched."""
        return (self.range_ns[1] - self.first_set_ns) / 1e9 if self.range_ns and self.first_set_ns else 0.0

    def see(self, log_ns: NDArray[np.uint64]) -> tuple[int, int]:
        """Widen the range of log times; returns that of these messages."""
        low, high = int(log_ns.min()), int(log_ns.max())
        self.range_ns = (min(self.range_ns[0], low), max(self.range_ns[1], high)) if self.range_ns else (low, high)
        first = low or int(log_ns[log_ns > 0].min(initial=high))
        if first:
            self.first_set_ns = min(self.first_set_ns or first, first)
        return low, high

    def chunk(self, head: Chunk, length: int) -> None:
        """Count a chunk whose record is `length` bytes long."""
        self.chunks += 1
        self.bare += not head.crc and head.size > 0
        self.places = (self.places + place(head.offset, length, head.first_ns, head.last_ns, head.compression,
                                           head.stop - head.start, head.size)) & _MASK
