"""The summary of a log: counted against the data, which are trusted over it."""

import struct
from dataclasses import dataclass

from pipeline.logs.batch import Problems
from pipeline.logs.bounds import BYTES_A_RECORD, MAX_RECORDS
from pipeline.logs.declared import Declared
from pipeline.logs.source import Source
from pipeline.logs.tally import Tally, place
from pipeline.recording.fields import text
from pipeline.recording.records import MAGIC, Op

MAX_SUMMARY_RECORD = 64 << 20
_FOOTER = 20
_MASK = (1 << 64) - 1


@dataclass(slots=True)
class Proof:
    """What a summary agrees to."""

    counts: bool = False
    """The numbers of messages, channel by channel."""
    places: bool = False
    """Where every chunk lies, and its times."""
    crc: bool = False
    """The summary has a CRC, and it is right."""
    declarations: int = 0
    """Schemas and channels that stand in both."""


class _DisagreementError(ValueError):
    """The summary is readable and says other things than the data."""


def check_summary(source: Source, declared: Declared, tally: Tally, problems: Problems) -> Proof:
    """Read what follows the data section to the end of the file and note where it differs from the data.

    Args:
        source: stands behind the end of data.
        declared: schemas and channels of the data.
        tally: counts of the data.
        problems: takes what is wrong.
    """
    start, proof = source.offset, Proof()
    source.restart_crc()
    try:
        _records(source, declared, tally, proof)
        footer = source.offset
        source.at += 9 + 16
        actual = source.crc()
        summary_start, _, crc = struct.unpack_from("<QQI", source.data, source.at - 16)
        source.at += 4
        if crc and crc != actual:
            raise ValueError("CRC mismatch")
        if summary_start not in (0, start) or (not summary_start and footer != start):
            raise ValueError(f"its start is given as byte {summary_start}, but it is byte {start}")
        proof.crc = bool(crc)
        if summary_start == 0:
            proof = Proof()
        if not source.fill(len(MAGIC)) or source.data[source.at : source.at + len(MAGIC)] != MAGIC:
            raise ValueError("no magic at its end")
        source.at += len(MAGIC)
    except _DisagreementError as error:
        problems.add(f"{error}; summary ignored", start, "summary")
        return Proof()
    except (ValueError, struct.error) as error:
        problems.add(f"summary is damaged: {error}; summary ignored", start, "summary")
        return Proof()
    if source.left:
        problems.add(f"{source.left} B after the end", source.offset, "odd")
    return proof


def _records(source: Source, declared: Declared, tally: Tally, proof: Proof) -> None:
    """Every record before the footer, which `source` then holds."""
    room, places, chunks = MAX_RECORDS + source.size // BYTES_A_RECORD, 0, 0
    seen: dict[int, int] = {Op.ATTACHMENT_INDEX: 0, Op.METADATA_INDEX: 0}
    while True:
        if not source.fill(9):
            raise ValueError("the file ends")
        op, size = struct.unpack_from("<BQ", source.data, source.at)
        room -= 1
        if size > MAX_SUMMARY_RECORD or room < 0:
            raise ValueError(f"record at byte {source.offset} declares {size} B")
        if not source.fill(9 + size):
            raise ValueError("the file ends")
        if op == Op.FOOTER:
            if size < _FOOTER:
                raise ValueError(f"footer of {size} B")
            break
        content = source.data[source.at + 9 : source.at + 9 + size]
        if op in (Op.MESSAGE, Op.CHUNK):
            raise ValueError(f"record of type {op} at byte {source.offset}")
        if op in (Op.SCHEMA, Op.CHANNEL):
            kind = "schema" if op == Op.SCHEMA else "channel"
            if not declared.agrees(kind, content):
                raise _DisagreementError(f"summary declares a {kind} otherwise than the data")
            proof.declarations += 1
        elif op == Op.CHUNK_INDEX:
            places, chunks = (places + _place(content)) & _MASK, chunks + 1
        elif op == Op.STATISTICS:
            _statistics(content, declared, tally)
            proof.counts = True
        if op in seen:
            seen[op] += 1
        source.at += 9 + size
    if chunks and (chunks, places) != (tally.chunks, tally.places):
        raise _DisagreementError("summary places the chunks otherwise than they lie")
    for op, name, count in ((Op.ATTACHMENT_INDEX, "attachments", tally.attachments),
                            (Op.METADATA_INDEX, "metadata records", tally.metadata)):
        if seen[op] not in (0, count):
            raise _DisagreementError(f"summary lists {seen[op]} {name}, data has {count}")
    proof.places = chunks == tally.chunks


def _place(content: bytes) -> int:
    first, last, offset, length, table = struct.unpack_from("<QQQQI", content)
    compression, at = text(content, 36 + table + 8, len(content))
    packed, plain = struct.unpack_from("<QQ", content, at)
    return place(offset, length, first, last, compression, packed, plain)


def _statistics(content: bytes, declared: Declared, tally: Tally) -> None:
    messages, schemas, channels, attachments, metadata, chunks, first, last, length = struct.unpack_from(
        "<QHIIIIQQI", content)
    listed = dict(struct.iter_unpack("<HQ", content[46 : 46 + length]))
    pairs = [("messages", messages, tally.messages), ("attachments", attachments, tally.attachments),
             ("metadata records", metadata, tally.metadata), ("chunks", chunks, tally.chunks),
             ("schemas", schemas, declared.schemas), ("channels", channels, len(declared.channels))]
    for name, claimed, found in pairs:
        if claimed != found:
            raise _DisagreementError(f"summary lists {claimed} {name}, data has {found}")
    for number in {*listed, *tally.counts}:
        if listed.get(number, 0) != tally.counts.get(number, 0):
            raise _DisagreementError(f"summary lists {listed.get(number, 0)} messages on channel {number}, "
                             f"data has {tally.counts.get(number, 0)}")
    if tally.range_ns not in (None, (first, last)):
        raise _DisagreementError("summary gives other times than the messages")
