"""Logs of other writers, read in a stream: everything that was written, and what is wrong with the file told."""

import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from pipeline.errors import RecordingError
from pipeline.logs.stream import LATEST_NS, open_log

EPOCH_NS = 1_700_000_000_000_000_000
SHARED = Path(__file__).parents[3] / "shared/logs"


def write(path: Path, messages: int = 300, **options: object) -> Path:
    """Two channels and a latched one, of many sizes."""
    rng = np.random.default_rng(5)
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 4000, "enable_data_crcs": True, **options})
        writer.start("ros2", "somebody else")
        schema = writer.register_schema("a/B", "ros2msg", b"float64 x\n")
        a = writer.register_channel("a", "cdr", schema, {"qos": "latched"})
        b = writer.register_channel("/b", "json", 0)
        writer.add_message(a, 0, b"latched", 0, 0)
        for k in range(messages):
            writer.add_message(b if k % 3 == 0 else a, EPOCH_NS + k * 1000, rng.bytes(int(rng.integers(0, 200))),
                               EPOCH_NS + k * 1000 - 7, k)
        writer.add_attachment(5, 6, "robot.urdf", "application/xml", b"<robot/>" * 400)
        writer.add_metadata("site", {"plant": "7"})
        writer.finish()
    return path


def told(path: Path, **options: bool) -> list[tuple[str, str]]:
    with open_log(path, **options) as log:
        for _ in log.batches():
            pass
        return [(p.kind, p.what) for p in log.problems]


def refusal(path: Path, **options: bool) -> RecordingError:
    with pytest.raises(RecordingError) as error:
        told(path, **options)
    assert str(path) in error.value.where and error.value.mend
    return error.value


def by_the_library(path: Path) -> dict[str, list[tuple[int, int, int, bytes]]]:
    found: dict[str, list[tuple[int, int, int, bytes]]] = {}
    with path.open("rb") as stream:
        for _, channel, m in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((m.log_time, m.publish_time, m.sequence, m.data))
    return found


def by_us(path: Path) -> dict[str, list[tuple[int, int, int, bytes]]]:
    found: dict[str, list[tuple[int, int, int, bytes]]] = {}
    with open_log(path) as log:
        for b in log.batches():
            rows = [(int(b.log_ns[k]), int(b.publish_ns[k]), int(b.sequence[k]), bytes(b.payload(k)))
                    for k in range(len(b))]
            found.setdefault(b.channel.topic, []).extend(rows)
    return found


WAYS = {
    "zstd": {}, "lz4": {"compression": CompressionType.LZ4}, "plain chunks": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False}, "one chunk": {"chunk_size": 1 << 20}, "no CRC": {"enable_crcs": False},
    "tiny chunks": {"chunk_size": 60},
}


@pytest.mark.parametrize("way", WAYS)
def test_everything_that_was_written_comes_back(tmp_path, way):
    path = write(tmp_path / "a.mcap", **WAYS[way])
    assert by_us(path) == by_the_library(path)
    assert told(path) == []
    with open_log(path) as log:
        assert log.metadata() == [("site", {"plant": "7"})]
        assert list(log.attachments()) == [("robot.urdf", "application/xml", b"<robot/>" * 400)]
        (a, b) = {batch.channel.topic: batch.channel for batch in log.batches()}.values()
        assert (a.topic, a.encoding, a.schema_name, a.schema_encoding, a.schema, dict(a.metadata)) == (
            "a", "cdr", "a/B", "ros2msg", b"float64 x\n", {"qos": "latched"})
        assert (b.topic, b.encoding, b.schema_name, b.schema) == ("/b", "json", "", b"")
        assert log.counts == {a.number: 201, b.number: 100}
        assert log.attached == [("robot.urdf", 3200)]


@pytest.mark.skipif(not SHARED.is_dir(), reason="no foreign logs on this machine")
def test_foreign_logs_read_as_the_library_reads_them():
    for path in SHARED.glob("*.mcap"):
        assert by_us(path) == by_the_library(path)
        assert {kind for kind, _ in told(path)} <= {"unproven"}


@pytest.mark.parametrize("way", ["zstd", "no chunks"])
def test_channels_that_nobody_wants_are_counted_only(tmp_path, way):
    with open_log(write(tmp_path / "a.mcap", **WAYS[way])) as log:
        assert {b.channel.topic for b in log.batches(lambda channel: channel.topic == "/b")} == {"/b"}
        assert sum(log.counts.values()) == 301


@pytest.mark.parametrize("way", ["zstd", "no chunks"])
def test_a_file_far_larger_than_the_window_is_read_block_by_block(tmp_path, way, monkeypatch):
    monkeypatch.setattr("pipeline.logs.source.BLOCK", 500)
    monkeypatch.setattr("pipeline.logs.attached.BLOCK", 500)
    path = write(tmp_path / "a.mcap", **WAYS[way])
    assert by_us(path) == by_the_library(path)
    assert told(path) == []


def test_metadata_attachments_and_a_second_reading_do_not_disturb_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.logs.source.BLOCK", 500)
    path = write(tmp_path / "a.mcap")
    with open_log(path) as log:
        found, second = list[bytes](), log.batches()
        for batch in log.batches():
            found += [bytes(batch.payload(k)) for k in range(len(batch)) if batch.channel.topic == "a"]
            assert log.metadata() == [("site", {"plant": "7"})] and len(list(log.attachments())) == 1
            next(second, None)
    assert found == [m[3] for m in by_the_library(path)["a"]]


def test_many_messages_of_one_chunk_come_in_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.logs.walk.PIECE", 50)
    monkeypatch.setattr("pipeline.logs.section.PIECE", 50)
    for way in ("one chunk", "no chunks"):
        path = write(tmp_path / "a.mcap", **WAYS[way])
        assert by_us(path) == by_the_library(path)
        with open_log(path) as log:
            assert max(map(len, log.batches())) <= 50


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"\x89MCAP0"], ids=["empty", "ros1", "half magic"])
def test_a_file_of_another_kind(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    error = refusal(path)
    assert error.what == "not an MCAP file (bad magic at byte 0)" and "mcap convert IN OUT.mcap" in error.mend


@pytest.mark.parametrize("way", ["zstd", "no chunks"])
def test_a_file_that_was_cut_off(tmp_path, way):
    path = write(tmp_path / "a.mcap", **WAYS[way])
    data, whole = path.read_bytes(), by_us(path)
    path.write_bytes(data[:12_000])
    error = refusal(path)
    start, _, count = error.what.partition("; recovered ")
    kept = int(count.split(";")[0])
    assert start == f"episode ends early after message {kept} (t = 0.00 s)", "seconds do not count from the latched one"
    assert "--accept-truncated" in error.what and "--accept-truncated" in error.mend
    with open_log(path, accept_truncated=True) as log:
        found: dict[str, list[bytes]] = {}
        for b in log.batches():
            found.setdefault(b.channel.topic, []).extend(bytes(b.payload(k)) for k in range(len(b)))
        assert sum(map(len, found.values())) == kept > 50
        assert log.problems[0].kind == "damage" and f"after message {kept}" in log.problems[0].what
    for topic, payloads in found.items():
        assert payloads == [m[3] for m in whole[topic]][: len(payloads)]
    unproven = [p for p in log.problems if p.kind == "unproven"]
    assert bool(unproven) == (way == "no chunks"), "of messages outside chunks, no CRC is left"


def test_a_damaged_chunk_ends_what_is_kept(tmp_path):
    path = write(tmp_path / "a.mcap", compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[9000] ^= 1
    path.write_bytes(data)
    error = refusal(path)
    assert error.what.startswith("chunk at byte ") and error.what.endswith(": CRC mismatch; quarantined")
    assert any(error.what in what for _, what in told(path, accept_truncated=True))


def test_damage_outside_chunks(tmp_path):
    path = write(tmp_path / "a.mcap")
    data = path.read_bytes()
    path.write_bytes(data.replace(b"plant", b"plans", 1))
    assert refusal(path).what == "data section: CRC mismatch; quarantined"
    path.write_bytes(data.replace(b"<robot/>", b"<ro_ot/>", 1))
    assert "attachment at byte" in refusal(path).what and "CRC mismatch" in refusal(path).what


def statistics(data: bytearray) -> int:
    """Where the statistics' content starts."""
    at = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    while data[at] != 0x0B:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return at + 9


def seal(data: bytearray) -> bytes:
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    struct.pack_into("<I", data, len(data) - 12, zlib.crc32(data[start : len(data) - 12]))
    return bytes(data)


@pytest.mark.parametrize(("offset", "code", "value", "message"), [
    (0, "<Q", 560, "summary lists 560 messages, data has 301; summary ignored"),
    (48, "<Q", 199, "summary lists 199 messages on channel 1, data has 201; summary ignored"),
    (22, "<I", 3, "summary lists 3 chunks, data has"),
    (26, "<Q", 77, "summary gives other times than the messages; summary ignored"),
], ids=["messages", "of a channel", "chunks", "times"])
def test_a_summary_that_lies_is_told_and_the_data_are_read(tmp_path, offset, code, value, message):
    path = write(tmp_path / "a.mcap")
    whole, data = by_us(path), bytearray(path.read_bytes())
    at = statistics(data) + offset
    struct.pack_into(code, data, at, value)
    path.write_bytes(seal(data))
    ((kind, what),) = told(path)
    assert kind == "summary" and what.startswith(message)
    assert by_us(path) == whole


def test_a_summary_that_is_cut_off_or_damaged(tmp_path):
    path = write(tmp_path / "a.mcap")
    whole, data = by_us(path), path.read_bytes()
    path.write_bytes(data[:-30])
    assert told(path) == [("summary", "summary is damaged: the file ends; summary ignored")]
    broken = bytearray(data)
    broken[-100] ^= 1
    path.write_bytes(broken)
    ((kind, what),) = told(path)
    assert kind == "summary" and what.endswith("summary ignored")
    path.write_bytes(data + b"more")
    assert told(path) == [("odd", "4 B after the end")]
    assert by_us(path) == whole


def test_what_no_crc_proves_is_said(tmp_path):
    path = write(tmp_path / "a.mcap", enable_data_crcs=False)
    assert told(path) == [("unproven", "metadata or channels without a CRC: damage would not be seen")]
    path = write(tmp_path / "a.mcap", enable_data_crcs=False, index_types=IndexType.NONE)
    assert ("unproven", "no CRC over the data and no sound summary: missing data would not be seen") in told(path)
    path = write(tmp_path / "a.mcap", enable_data_crcs=False, use_chunking=False)
    assert ("unproven", "chunks, messages or attachments without a CRC: damage would not be seen") in told(path)


def test_times_beyond_what_int64_holds_are_told(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start()
        a = writer.register_channel("a", "json", 0)
        for stamp in (5, (1 << 64) - 1, LATEST_NS):
            writer.add_message(a, stamp, b"{}", stamp)
        writer.finish()
    with open_log(path) as log:
        (batch,) = log.batches()
        assert batch.log_ns.tolist() == batch.publish_ns.tolist() == [5, LATEST_NS, LATEST_NS]
        assert log.problems[0].kind == "odd" and "2^63 ns" in log.problems[0].what


def record(op: int, content: bytes) -> bytes:
    return struct.pack("<BQ", op, len(content)) + content


def file_of(*records: bytes) -> bytes:
    body = b"\x89MCAP0\r\n" + record(1, bytes(8)) + b"".join(records)
    return body + record(15, struct.pack("<I", zlib.crc32(body))) + record(2, bytes(20)) + b"\x89MCAP0\r\n"


def chunk_of(plain: bytes, *, size: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 0, len(plain) if size is None else size, zlib.crc32(plain))
    return record(6, head + bytes(4) + struct.pack("<Q", len(plain)) + plain)


CHANNEL = record(4, struct.pack("<HH", 1, 0) + struct.pack("<I", 1) + b"x" + struct.pack("<I", 1) + b"y" + bytes(4))
OTHER = CHANNEL.replace(b"x", b"z")
MESSAGE = record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + b"hi")


@pytest.mark.parametrize(("data", "message"), [
    (file_of(record(6, struct.pack("<QQQI", 0, 0, 1 << 31, 0) + bytes(12))),
     "chunk at byte 25 declares 2147483648 B, limit 67108864"),
    (file_of(struct.pack("<BQ", 5, 1 << 40)), "record at byte 25 declares 1099511627776 B, limit 67108864"),
    (file_of(struct.pack("<BQ", 9, 1 << 63)), "record at byte 25 declares 9223372036854775808 B, limit 67108864"),
    (file_of(chunk_of(bytes(10), size=64 << 20)), "chunk at byte 25 declares 67108864 B out of 10, limit 1000 to 1"),
    (file_of(MESSAGE), "messages on channel 1, which was never declared"),
    (file_of(CHANNEL, OTHER), "record at byte 52 is damaged: channel 1 is declared twice, differently"),
    (file_of(chunk_of(CHANNEL + MESSAGE[:-1])), "chunk at byte 25 is damaged: record at byte 27 of the unpacked chunk "
     "is cut off"),
    (file_of(chunk_of(CHANNEL + chunk_of(b""))), "chunk at byte 25 is damaged: record of type 6 at byte 27"),
    (file_of(record(5, bytes(9))), "message at byte 25 has 9 B"),
], ids=["size", "length", "attachment", "ratio", "undeclared", "declared anew", "cut message", "nested", "short"])
def test_what_cannot_be_is_refused(tmp_path, data, message):
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    for options in ({}, {"accept_truncated": True}):
        try:
            found = told(path, **options)
        except RecordingError as error:
            assert error.what.startswith(message) and "\n" not in error.what and error.mend
        else:
            assert options and any(message in what for _, what in found)


def test_chunks_that_declare_too_much_together_are_refused_before_one_is_unpacked(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(CHANNEL, *[chunk_of(bytes(70_000), size=60 << 20)] * 4))
    error = refusal(path)
    assert error.what.startswith("chunks up to byte") and "declare more than" in error.what
    assert "made to fill memory" in error.mend and "mcap filter" in error.mend


def test_records_that_nobody_knows_are_passed_over(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(CHANNEL, record(0x90, b"own"), MESSAGE, chunk_of(record(0x91, b"own") + MESSAGE)))
    assert [len(b) for b in map(list, by_us(path).values())] == [2]
    assert [w for k, w in told(path) if k == "odd"] == ["record of type 144 in the data; skipped",
                                                       "unknown opcode 145 in a chunk; skipped"]


def test_a_chunk_that_calls_itself_an_index_is_told(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(CHANNEL, MESSAGE, b"\x07" + chunk_of(MESSAGE)[1:]))
    assert ("damage", "a message index is no such thing") in told(path)


def test_a_channel_whose_schema_is_missing_is_told(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(CHANNEL[:11] + b"\x09" + CHANNEL[12:], MESSAGE))
    assert ("odd", "channel 1 names schema 9, which was never declared") in told(path)


def test_a_folder_a_pipe_and_nothing(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "Is a directory" in refusal(tmp_path).what
    assert refusal(tmp_path / "pipe").what == "not a regular file"
    assert "No such file" in refusal(tmp_path / "none").what


def test_the_library_loses_what_we_tell(tmp_path):
    """The reason for all this: one damaged byte of the summary, and the library's reader drops messages in silence."""
    path = write(tmp_path / "a.mcap")
    data, total, silent = path.read_bytes(), len(by_us(path)["a"]), 0
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    for at in range(start, len(data) - 40, 12):
        broken = bytearray(data)
        broken[at] ^= 4
        path.write_bytes(broken)
        assert len(by_us(path)["a"]) == total and told(path)
        try:
            reader = make_reader(io.BytesIO(broken), validate_crcs=True)
            silent += sum(1 for _, c, _ in reader.iter_messages() if c.topic == "a") != total
        except (McapError, ValueError, KeyError, UnicodeDecodeError, struct.error, OverflowError, AssertionError):
            pass
    assert silent > 0
