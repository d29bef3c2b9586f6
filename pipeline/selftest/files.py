"""Faults of a file's bytes: cut short, damaged, or with a summary that lies."""

import struct
import zlib

import numpy as np

type Rng = np.random.Generator

MAGIC_BYTES, FOOTER_BYTES = 8, 8 + 8 + 4
OPCODE_LENGTH = 1 + 8
CHUNK, STATISTICS = 0x06, 0x0B


def truncated(data: bytes, rng: Rng) -> bytes:
    """The file ends after 60 to 90 % of its bytes: a copy that broke off."""
    return data[:int(rng.uniform(0.6, 0.9) * len(data))]


def corrupt_chunk(data: bytes, rng: Rng) -> bytes:
    """One bit of one chunk has flipped on the disk."""
    chunks = [(at, length) for opcode, at, length in records(data) if opcode == CHUNK]
    at, length = chunks[int(rng.integers(len(chunks)))]
    place = at + int(rng.uniform(0.3, 0.9) * length)
    return data[:place] + bytes([data[place] ^ 1 << int(rng.integers(8))]) + data[place + 1:]


def lying_summary(data: bytes, rng: Rng) -> bytes:
    """The summary counts 3 to 40 messages fewer than the file holds, under a CRC that is right."""
    at = next(at for opcode, at, _ in records(data) if opcode == STATISTICS)
    count, = struct.unpack_from("<Q", data, at)
    told = bytearray(data)
    struct.pack_into("<Q", told, at, count - int(rng.integers(3, 40)))
    footer = len(data) - MAGIC_BYTES - FOOTER_BYTES
    summary, _ = struct.unpack_from("<QQ", told, footer)
    struct.pack_into("<I", told, len(data) - MAGIC_BYTES - 4, zlib.crc32(told[summary:len(data) - MAGIC_BYTES - 4]))
    return bytes(told)


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, place of the content and its length of every top-level record. Source: the MCAP specification, 1.0."""
    found: list[tuple[int, int, int]] = []
    at = MAGIC_BYTES
    while at < len(data) - MAGIC_BYTES:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at + OPCODE_LENGTH, length))
        at += OPCODE_LENGTH + length
    return found
