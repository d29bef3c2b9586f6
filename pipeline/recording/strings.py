"""The records of a file that say what it is: the metadata `episode`, or what was known when it began."""

import struct
import zlib
from contextlib import suppress
from pathlib import Path

from pipeline.recording import fields, metadata
from pipeline.recording.errors import reading, refuse
from pipeline.recording.live_header import START
from pipeline.recording.scan import Scan


def finished(found: Scan) -> bool:
    """Whether the writer came to the end of the attempt: a live recording says so only there."""
    names = set[str]()
    for start, stop in found.metadata:
        with suppress(ValueError, struct.error):
            names.add(fields.text(found.data, start, stop)[0])
    return metadata.NAME in names or START not in names


def episode_strings(found: Scan, path: Path) -> dict[str, str]:
    """The strings of the metadata record `episode`, or of `episode_start` where a live recording was cut off."""
    return strings_of(found, path, metadata.NAME if finished(found) else START)


def strings_of(found: Scan, path: Path, wanted: str) -> dict[str, str]:
    """The strings of one metadata record, its seal checked."""
    for start, stop in found.metadata:
        with reading(path, f"metadata at byte {start - 9}"):
            name, at = fields.text(found.data, start, stop)
            if name == wanted:
                values, _ = fields.pairs(found.data, at, stop)
                if metadata.SEAL in values and values[metadata.SEAL] != metadata.seal(values):
                    raise ValueError("sha256 mismatch")
                return values
    raise refuse("no metadata record 'episode'", path,
                 "record with pipeline.recording, or bring the file in as a foreign log")


def attached_files(found: Scan) -> dict[str, bytes]:
    """File name -> content of every attachment."""
    files: dict[str, bytes] = {}
    for start, stop in found.attachments:
        with reading(found.where, f"attachment at byte {start - 9}"):
            head = fields.attachment(found.data, start, stop)
            (crc,) = struct.unpack_from("<I", found.data, head.stop)
            if zlib.crc32(memoryview(found.data)[start : head.stop]) != crc:
                raise ValueError("CRC mismatch")
            files[head.name] = found.data[head.start : head.stop]
    return files
