"""The summary at a file's end: what it claims, to be counted against the data and never trusted over it."""

import struct
import zlib
from typing import NamedTuple

from pipeline.recording.records import FOOTER_BYTES, MAGIC, Op


class Summary(NamedTuple):
    """What the summary claims."""

    messages: int
    counts: dict[int, int]
    """Channel number -> messages."""


def read_summary(data: bytes | memoryview) -> Summary:
    """Read the statistics of a whole file, or of as many bytes of its end as hold the summary.

    Args:
        data: the file's bytes.

    Raises:
        ValueError: magic, footer, CRC or statistics are missing or damaged.
    """
    end = len(data) - len(MAGIC)
    start = end - FOOTER_BYTES
    if start < len(MAGIC) or bytes(data[end:]) != MAGIC or data[start] != Op.FOOTER:
        raise ValueError("no footer at the end of the file")
    summary_start, _, crc = struct.unpack_from("<QQI", data, start + 9)
    if not len(MAGIC) <= summary_start <= start:
        raise ValueError(f"summary at byte {summary_start} of {len(data)}")
    if zlib.crc32(data[summary_start : end - 4]) != crc:
        raise ValueError("summary: CRC mismatch")
    at = summary_start
    while at + 9 <= start:
        op, size = struct.unpack_from("<BQ", data, at)
        at += 9
        if op == Op.STATISTICS and 46 <= size <= start - at:
            messages, *_, length = struct.unpack_from("<QHIIIIQQI", data, at)
            table = bytes(data[at + 46 : at + 46 + length])
            return Summary(messages, dict(struct.iter_unpack("<HQ", table)))
        at += size
    raise ValueError("summary without statistics")
