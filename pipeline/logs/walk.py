"""Messages found in plain bytes, their fields as arrays."""

import struct
from array import array
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD, Op

PIECE = 100_000
"""Most messages in one piece, so that a chunk of tiny ones cannot fill memory."""
HEAD = np.dtype([("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"),
                 ("publish", "<u8")])
_PEEK = struct.Struct("<BQ")


def message_run(data: bytes, at: int, starts: "array[int]") -> int:
    """Append where each whole message starts, of those that follow one another from `at`; at most to PIECE.

    Returns:
        Where the run ends: at another record, at one that is cut off or too short, or at the end.
    """
    peek, append, message, least, end = _PEEK.unpack_from, starts.append, int(Op.MESSAGE), MESSAGE_FIELDS, len(data)
    last = end - 9
    for _ in range(PIECE - len(starts)):
        if at > last:
            break
        op, size = peek(data, at)
        stop = at + 9 + size
        if op != message or size < least or stop > end:
            break
        append(at)
        at = stop
    return at


def heads(data: bytes, starts: "array[int]") -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Starts as an array, and the fields before each payload, shape (n,) each; empties `starts`."""
    places = np.array(starts, np.int64)
    del starts[:]
    everywhere: NDArray[np.void] = np.ndarray(len(data) - MESSAGE_HEAD.size + 1, HEAD, data, strides=(1,))
    return places, everywhere[places]


def groups(channels: NDArray[np.uint16]) -> tuple[NDArray[np.intp] | None, list[tuple[int, int, int]]]:
    """Sort messages by channel, each channel's in their order.

    Returns:
        The order, None where all are of one channel; and (channel number, first, stop) in that order.
    """
    if (channels == channels[0]).all():
        return None, [(int(channels[0]), 0, len(channels))]
    order = np.argsort(channels, kind="stable")
    inside = channels[order]
    bounds = [0, *(np.flatnonzero(inside[1:] != inside[:-1]) + 1).tolist(), len(order)]
    return order, [(int(inside[a]), a, b) for a, b in pairwise(bounds)]
