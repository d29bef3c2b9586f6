"""What goes between the control loop and a candidate's process: numbers in a fixed little-endian layout, no pickle.

One packet of a local socket is one question or one answer; the kernel hands over whole packets or none, so that a
sender that dies in the middle leaves nothing half read.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.protocols import Array, Ids, Observation

READY, REFUSED, ANSWER, FAILED = range(1, 5)
"""Kinds of what a candidate says."""

MAX_ROWS = 256
"""Attempts of the reference arm in one packet: a socket's buffer (208 KiB by default) holds several ticks of them."""
MAX_TEXT = 300
"""Longest reason that a candidate may give [B]."""

_QUESTION = struct.Struct("<IIIQHH")
"""epoch, attempts, rows, number, widths of state and environment; then ids as int32, both as float32, row by row."""
_ANSWER = struct.Struct("<BxxxIQ")
"""kind, rows, number; then the actions as float64, row by row, or a text."""
_WIDTH = len(STATE) + len(ENVIRONMENT)
MAX_PACKET = _QUESTION.size + MAX_ROWS * 4 * (1 + _WIDTH)
"""Longest packet of either side [B]."""


def rows_at_once(width: int) -> int:
    """Attempts in one packet where a robot perceives `width` values: as many bytes as of the arm."""
    return max(1, min(MAX_ROWS, MAX_ROWS * (1 + _WIDTH) // (1 + width)))


@dataclass(frozen=True, slots=True)
class Question:
    """What some attempts perceive at one tick."""

    epoch: int
    """Grows with every reset: memories of another epoch are forgotten."""
    attempts: int
    """How many attempts the epoch has."""
    number: int
    """Counts packets; where one is missing, memories are forgotten too."""
    ids: Ids
    """Which attempts, shape (rows,)."""
    observation: Observation


@dataclass(frozen=True, slots=True)
class Said:
    """What a candidate's process says."""

    kind: int
    number: int
    """Of the question."""
    rows: int
    actions: Array | None = None
    """Shape (rows, width), for ANSWER."""
    text: str = ""
    """For the other kinds."""


def question(epoch: int, attempts: int, number: int, ids: Ids, observation: Observation) -> bytes:
    """A packet that asks; float32, because that is what every policy of ours is given."""
    rows = len(ids)
    values = np.concatenate([observation.state, observation.environment], axis=1, dtype=np.float32, casting="same_kind")
    widths = observation.state.shape[1], observation.environment.shape[1]
    return b"".join((_QUESTION.pack(epoch, attempts, rows, number, *widths), ids.astype("<i4").tobytes(),
                     values.astype("<f4", copy=False).tobytes()))


def asked(packet: bytes) -> Question:
    """A question as it was packed."""
    epoch, attempts, rows, number, first, second = _QUESTION.unpack_from(packet)
    width = first + second
    ids = np.frombuffer(packet, "<i4", rows, _QUESTION.size).astype(np.intp)
    values = np.frombuffer(packet, "<f4", rows * width, _QUESTION.size + 4 * rows).reshape(rows, width)
    state, environment = (part.astype(np.float64) for part in np.split(values, [first], axis=1))
    return Question(epoch, attempts, number, ids, Observation(state, environment))


def answer(number: int, actions: NDArray[np.float64]) -> bytes:
    """A packet with the actions (rows, width) for one question."""
    return _ANSWER.pack(ANSWER, len(actions), number) + actions.astype("<f8").tobytes()


def word(kind: int, text: str = "", number: int = 0) -> bytes:
    """A packet that says READY, REFUSED or FAILED."""
    return _ANSWER.pack(kind, 0, number) + text.encode("ascii", "replace")[:MAX_TEXT]


def said(packet: bytes, width: int = len(ACTION)) -> Said:
    """What a candidate said; ValueError where it keeps to no layout: its process may have been taken over.

    Args:
        packet: as it came.
        width: of an action.
    """
    try:
        kind, rows, number = _ANSWER.unpack_from(packet)
    except struct.error as error:
        raise ValueError(f"{len(packet)} B are no packet") from error
    body: Any = memoryview(packet)[_ANSWER.size:]
    if kind == ANSWER:
        if len(body) != 8 * rows * width:
            raise ValueError(f"{len(body)} B for {rows} actions")
        return Said(kind, number, rows, np.frombuffer(body, "<f8").reshape(rows, width))
    if kind not in (READY, REFUSED, FAILED) or len(body) > MAX_TEXT:
        raise ValueError(f"kind {kind} with {len(body)} B")
    text = bytes(body).decode("ascii", "replace")
    return Said(kind, number, rows, text="".join(c if c.isprintable() else " " for c in text))
