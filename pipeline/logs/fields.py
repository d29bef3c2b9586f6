"""Fields: what the messages of one batch say, as columns; what every decoder gives."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pipeline.logs.batch import Batch

type Numbers = NDArray[Any]
"""An array of bool, integer or float in the machine's byte order."""

STAMPS = ("header.stamp", "stamp", "timestamp", "header.timestamp")
"""Where messages keep the time of what they tell, the first that is there counts."""


@dataclass(frozen=True, slots=True)
class Fields:
    """The n messages of a batch that could be decoded, one column a field.

    A column is named by its dotted path. What lies below a sequence of messages is laid end to end: the joint
    targets of every point of a trajectory are one column `points.positions`, those of the first point first.
    """

    rows: NDArray[np.intp]
    """Which messages of the batch these are, rising, shape (n,)."""
    bad: tuple[tuple[int, str], ...] = ()
    """(message of the batch, reason) of those that could not be decoded, rising."""
    values: dict[str, Numbers] = field(default_factory=dict[str, Numbers])
    """Path -> numbers, shape (n,), or (n, k) for a sequence that has k values in every message. Times and durations
    are one int64 column [ns]."""
    ragged: dict[str, list[Numbers]] = field(default_factory=dict[str, list[Numbers]])
    """Path -> one array (k,) a message, for a sequence whose length changes within the batch."""
    texts: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Path -> one text a message."""
    names: dict[str, list[tuple[str, ...]]] = field(default_factory=dict[str, list[tuple[str, ...]]])
    """Path -> one sequence of texts a message, such as JointState.name."""
    blobs: dict[str, list[memoryview]] = field(default_factory=dict[str, list[memoryview]])
    """Path -> one sequence of bytes a message, such as an image; a view, not a copy."""
    header_ns: NDArray[np.int64] | None = None
    """The message's own stamp (see STAMPS) [ns], shape (n,); None where the type has none."""
    times: frozenset[str] = frozenset()
    """Paths of the values that are times or durations."""

    def __len__(self) -> int:
        return len(self.rows)


class Decoder(Protocol):
    """Decodes the messages of one channel."""

    def decode(self, batch: "Batch", /) -> Fields:
        """What the batch's messages say; a message that does not fit its schema is named in `bad`, never raised."""
        ...
