"""Mutants of a log: faults that disks, cables and people make, and lies that a hostile writer tells."""

import struct
import zlib
from dataclasses import dataclass

import lz4.frame
import numpy as np
import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX, ATTACHMENT = 1, 2, 3, 4, 5, 6, 7, 8, 9
STATISTICS, METADATA, DATA_END = 0xB, 0xC, 0xF
ABSURD = (0, 1, 21, 22, 255, 1 << 20, (1 << 31) - 1, 1 << 31, 64 << 20, (64 << 20) + 1, (1 << 63) - 1, (1 << 64) - 1)


def absurd(rng: np.random.Generator, *more: int) -> int:
    """A number that a length field should not hold."""
    values = (*ABSURD, *more)
    return values[int(rng.integers(0, len(values)))]


@dataclass(frozen=True)
class Mutant:
    """A file that is not what it was."""

    kind: str
    data: bytes
    forged: bool = False
    """Every CRC was made right again, so that only another reader can say what the file holds now."""


def mutant(seed: bytes, rng: np.random.Generator) -> Mutant:
    """One mutant."""
    draw = int(rng.integers(0, 200))
    if draw < 80:
        return raw(seed, rng)
    if draw < 120:
        return records(seed, rng)
    if draw < 150:
        return chunk_header(seed, rng)
    if draw < 172:
        return summary(seed, rng)
    if draw < 197:
        return inside(seed, rng)
    return bomb(seed, rng)


def raw(seed: bytes, rng: np.random.Generator) -> Mutant:
    """Bytes changed without looking at what they are."""
    out, at, size = bytearray(seed), int(rng.integers(0, len(seed))), int(rng.integers(1, 2000))
    kind = str(rng.choice(["flip a bit", "flip a byte", "zeros", "noise", "lost bytes", "doubled bytes", "cut off",
                           "bytes behind the end", "bytes from elsewhere"]))
    match kind:
        case "flip a bit":
            out[at] ^= 1 << int(rng.integers(0, 8))
        case "flip a byte":
            out[at] ^= int(rng.integers(1, 256))
        case "zeros":
            out[at : at + size] = bytes(len(out[at : at + size]))
        case "noise":
            out[at : at + 8] = rng.bytes(len(out[at : at + 8]))
        case "lost bytes":
            del out[at : at + size]
        case "doubled bytes":
            out[at:at] = out[at : at + size]
        case "cut off":
            del out[at:]
        case "bytes behind the end":
            out += rng.bytes(size)
        case _:
            other = int(rng.integers(0, len(seed)))
            out[at : at + size] = seed[other : other + len(out[at : at + size])]
    return Mutant(kind, bytes(out))


type Records = list[tuple[int, bytes]]


def split(data: bytes) -> Records:
    """Opcode and content of every record of a sound file."""
    found: Records = []
    at = len(MAGIC)
    while at < len(data) - len(MAGIC):
        op, size = struct.unpack_from("<BQ", data, at)
        found.append((op, data[at + 9 : at + 9 + size]))
        at += 9 + size
    return found


def join(parts: Records, *, seal: bool) -> bytes:
    """A file of records; sealed: CRCs over data and summary, where there were some, and the footer made right."""
    out, start = bytearray(MAGIC), 0
    for op, content in parts:
        if seal and op == DATA_END and content[:4] != bytes(4):
            content = struct.pack("<I", zlib.crc32(out))
        if seal and op == FOOTER and len(content) == 20:
            first, offsets, crc = struct.unpack("<QQI", content)
            head = struct.pack("<BQQQ", FOOTER, 20, start if first else 0, offsets)
            content = head[9:] + struct.pack("<I", zlib.crc32(bytes(out[start:]) + head) if crc else 0)
        out += struct.pack("<BQ", op, len(content)) + content
        if op == DATA_END:
            start = len(out)
    return bytes(out + MAGIC)


def records(seed: bytes, rng: np.random.Generator) -> Mutant:
    """Whole records lost, doubled, moved, renamed, or with a length that lies."""
    parts, out = split(seed), None
    kind = str(rng.choice(["lost record", "doubled record", "moved record", "other opcode", "length lies",
                           "file within the file"]))
    k = int(rng.integers(0, len(parts)))
    seal = bool(rng.integers(0, 2))
    match kind:
        case "lost record":
            del parts[k]
        case "doubled record":
            parts.insert(k, parts[k])
        case "moved record":
            parts.insert(int(rng.integers(0, len(parts))), parts.pop(k))
        case "other opcode":
            parts[k] = (int(rng.choice([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 15, 16, 127, 128, 255])), parts[k][1])
        case "file within the file":
            parts.insert(k, (int(rng.choice([CHUNK, ATTACHMENT, METADATA, 0x80])), seed[: 4000]))
        case _:
            at = len(MAGIC) + sum(9 + len(content) for _, content in parts[:k])
            out = bytearray(seed)
            true = len(parts[k][1])
            lie = int(rng.choice([true - 1, true + 1, true + 9])) if rng.integers(0, 2) else absurd(rng)
            struct.pack_into("<Q", out, at + 1, max(0, lie))
    if out is not None:
        return Mutant(kind, bytes(out))
    return Mutant(f"{kind}, sealed" if seal else kind, join(parts, seal=seal), forged=seal)


def chunk_header(seed: bytes, rng: np.random.Generator) -> Mutant:
    """A chunk whose header lies; in a file without chunks, a message whose header does."""
    parts = split(seed)
    which = [k for k, (op, _) in enumerate(parts) if op == CHUNK]
    if not which:
        return message_header(seed, rng)
    k = int(rng.choice(which))
    content = bytearray(parts[k][1])
    field = str(rng.choice(["times", "size", "CRC", "compression", "packed length"]))
    (length,) = struct.unpack_from("<I", content, 28)
    match field:
        case "times":
            struct.pack_into("<Q", content, int(rng.choice([0, 8])), int(rng.integers(0, 1 << 62)))
        case "size":
            lie = absurd(rng, len(content))
            struct.pack_into("<Q", content, 16, lie)
        case "CRC":
            struct.pack_into("<I", content, 24, int(rng.integers(0, 1 << 32)) if rng.integers(0, 3) else 0)
        case "compression":
            name = [b"", b"lz4", b"zstd", b"zst\xff", b"none", b"x" * 90][int(rng.integers(0, 6))]
            content[28 : 32 + length] = struct.pack("<I", len(name)) + name
        case _:
            struct.pack_into("<Q", content, 32 + length, absurd(rng, len(content) - 39 - length))
    parts[k] = (CHUNK, bytes(content))
    return Mutant(f"chunk header lies: {field}", join(parts, seal=True))


def message_header(seed: bytes, rng: np.random.Generator) -> Mutant:
    """A message of a file without chunks on another channel or at another time, the CRC left as it was."""
    parts = split(seed)
    k = int(rng.choice([k for k, (op, _) in enumerate(parts) if op == MESSAGE]))
    content = bytearray(parts[k][1])
    struct.pack_into("<H", content, 0, int(rng.choice([0, 1, 2, 3, 77])))
    struct.pack_into("<Q", content, 6, int(rng.integers(0, 1 << 63, dtype=np.uint64)) << 1)
    parts[k] = (MESSAGE, bytes(content))
    return Mutant("message header lies", join(parts, seal=False))


def summary(seed: bytes, rng: np.random.Generator) -> Mutant:
    """A summary that says other things than the data, its CRC right."""
    parts = split(seed)
    end = next(k for k, (op, _) in enumerate(parts) if op == DATA_END)
    inside = list(range(end + 1, len(parts) - 1))
    if not inside:
        return raw(seed, rng)
    k = int(rng.choice(inside))
    kind = str(rng.choice(["changed", "lost", "doubled", "all lost", "footer lies"]))
    match kind:
        case "changed":
            content = bytearray(parts[k][1])
            for _ in range(int(rng.integers(1, 4))):
                content[int(rng.integers(0, len(content)))] = int(rng.integers(0, 256))
            parts[k] = (parts[k][0], bytes(content))
        case "lost":
            del parts[k]
        case "doubled":
            parts.insert(k, parts[k])
        case "all lost":
            del parts[end + 1 : -1]
        case _:
            data = bytearray(seed)
            struct.pack_into("<Q", data, len(data) - len(MAGIC) - 20 + int(rng.choice([0, 8])),
                             absurd(rng, len(data)))
            return Mutant("summary: footer lies", bytes(data))
    return Mutant(f"summary: {kind}", join(parts, seal=True))


def inside(seed: bytes, rng: np.random.Generator) -> Mutant:
    """Plain bytes of a chunk changed and packed again, with the right size and CRC."""
    parts = split(seed)
    which = [k for k, (op, _) in enumerate(parts) if op == CHUNK]
    if not which:
        return records(seed, rng)
    k = int(rng.choice(which))
    name, plain = unpack(parts[k][1])
    out, at = bytearray(plain), int(rng.integers(0, len(plain)))
    kind = str(rng.choice(["bytes", "cut", "length lies", "chunk in the chunk", "unknown record", "unknown channel",
                           "channel anew"]))
    match kind:
        case "bytes":
            out[at : at + 4] = rng.bytes(len(out[at : at + 4]))
        case "cut":
            del out[at:]
        case "length lies":
            places, at = [0], 0
            while (at := at + 9 + struct.unpack_from("<Q", plain, at + 1)[0]) < len(plain):
                places.append(at)
            struct.pack_into("<Q", out, int(rng.choice(places)) + 1, absurd(rng))
        case "chunk in the chunk":
            out += struct.pack("<BQ", CHUNK, len(parts[k][1])) + parts[k][1]
        case "unknown record":
            out += struct.pack("<BQ", int(rng.choice([0, 7, 16, 128])), 5) + b"hello"
        case "unknown channel":
            out += struct.pack("<BQHIQQ", MESSAGE, 26, 999, 0, 1, 1) + b"data"
        case _:
            text = struct.pack("<I", 2) + b"/x"
            content = struct.pack("<HH", 1, 0) + text + text + bytes(4)
            out += struct.pack("<BQ", CHANNEL, len(content)) + content
    parts[k] = (CHUNK, pack(name, bytes(out), parts[k][1][:16]))
    return Mutant(f"inside a chunk: {kind}", join(parts, seal=True), forged=True)


def unpack(content: bytes) -> tuple[str, bytes]:
    """Compression and plain bytes of a chunk."""
    size, _, length = struct.unpack_from("<QII", content, 16)
    name, packed = content[32 : 32 + length].decode(), content[40 + length :]
    match name:
        case "zstd":
            return name, zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        case "lz4":
            return name, lz4.frame.decompress(packed)
        case _:
            return name, packed


def pack(name: str, plain: bytes, times: bytes = bytes(16), *, size: int | None = None) -> bytes:
    """Content of a chunk record."""
    packed = {"zstd": zstandard.ZstdCompressor(level=1).compress, "lz4": lz4.frame.compress, "": bytes}[name](plain)
    head = times + struct.pack("<QI", len(plain) if size is None else size, zlib.crc32(plain))
    return head + struct.pack("<I", len(name)) + name.encode() + struct.pack("<Q", len(packed)) + packed


def bomb(seed: bytes, rng: np.random.Generator) -> Mutant:
    """A small file that wants to be large, or to take forever."""
    kind = str(rng.choice(["zeros", "many chunks", "hidden size", "tiny messages", "empty records", "declarations"]))
    name = str(rng.choice(["zstd", "lz4"]))
    channel = struct.pack("<HH", 1, 0) + (struct.pack("<I", 1) + b"x") * 2 + bytes(4)
    declare = struct.pack("<BQ", CHANNEL, len(channel)) + channel
    tiny = struct.pack("<BQHIQQ", MESSAGE, 22, 1, 0, 1, 1)
    match kind:
        case "zeros":
            parts = [(CHUNK, pack("zstd", bytes(60 << 20)))]
        case "many chunks":
            one = (CHUNK, pack(name, declare + tiny * 33_000))
            parts = [one] * 300
        case "hidden size":
            parts = [(CHUNK, pack(name, bytes(8 << 20), size=1000))]
        case "tiny messages":
            parts = [(CHUNK, pack(name, declare + tiny * 33_000))] * 60
        case "empty records":
            parts = [(CHUNK, pack(name, declare + struct.pack("<BQ", 0x80, 0) * 110_000))] * 20
        case _:
            parts = [(CHUNK, pack(name, declare * 50_000))] * 20
    body = [(HEADER, bytes(8)), *parts, (DATA_END, bytes(4)), (FOOTER, bytes(20))]
    return Mutant(f"bomb: {kind}", join(body, seal=False))
