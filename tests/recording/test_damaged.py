"""Damaged, hostile and ill-made files: one error that says what, where and the mend; never a silent difference."""

import dataclasses
import logging
import os
import re
import struct
import time
import zlib

import numpy as np
import pytest
import zstandard

from pipeline.errors import RecordingError
from pipeline.recording import cdr, read_episode, read_frames, write_episode
from pipeline.recording.dialect import JOINT_NAMES
from pipeline.recording.records import MAGIC, Op

CHUNK_BYTE = 9 + 32 + 4 + 8


def chunk_at(data: bytes, number: int = 0) -> int:
    """Where a chunk record starts."""
    at = len(MAGIC)
    while True:
        op, size = struct.unpack_from("<BQ", data, at)
        if op == Op.CHUNK:
            if number == 0:
                return at
            number -= 1
        at += 9 + size


def refusal(path, **kwargs) -> RecordingError:
    """Both readers refuse with the same words."""
    with pytest.raises(RecordingError) as frames:
        read_frames(path, **kwargs)
    with pytest.raises(RecordingError) as whole:
        read_episode(path, **kwargs)
    assert str(frames.value) == str(whole.value)
    return frames.value


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\0", MAGIC[:5]], ids=["empty", "other format", "half magic"])
def test_a_file_that_is_no_mcap(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    error = refusal(path)
    assert error.what == "not an MCAP file (bad magic at byte 0)"
    assert (error.where, "mcap convert IN OUT.mcap" in error.mend) == (str(path), True)


def test_a_file_that_is_not_there(tmp_path):
    assert "No such file" in refusal(tmp_path / "a.mcap").what
    assert "Is a directory" in refusal(tmp_path).what


def test_a_truncated_file_says_what_it_holds_and_how_to_keep_it(tmp_path, trace, episode):
    path = tmp_path / "a.mcap"
    write_episode(path, episode(400), trace(400), attachments={})
    data = path.read_bytes()
    path.write_bytes(data[: chunk_at(data, 2) + 100])
    error = refusal(path)
    said = re.fullmatch(r"episode ends early after message (\d+) \(t = (\d+\.\d\d) s\); recovered \1; "
                        r"pass --accept-truncated to keep it", error.what)
    assert said and "--accept-truncated" in error.mend
    found, kept = read_episode(path, accept_truncated=True)
    assert 100 < found.frames < 400 and len(kept) == found.frames
    assert float(said[2]) == pytest.approx((found.frames - 1) / 20, abs=0.01)
    assert kept.sim_state.tobytes() == trace(400).sim_state[: found.frames].tobytes()
    assert (found.outcome.label, found.outcome.tick) == ("unknown", None)
    assert f"truncated: {found.frames} of 400 frames kept" in found.outcome.reason


def test_a_flipped_byte_in_a_chunk(recording):
    data = bytearray(recording.read_bytes())
    at = chunk_at(data)
    data[at + 9 + 28 - 4] ^= 1  # the chunk's own CRC field
    recording.write_bytes(data)
    error = refusal(recording)
    assert error.what == f"chunk at byte {at}: CRC mismatch; quarantined"
    assert "fetch the recording again" in error.mend


def test_a_flipped_byte_outside_the_chunks(recording):
    data = recording.read_bytes()
    recording.write_bytes(data.replace(b'"stratum":"rare"', b'"stratum":"rbre"'))
    assert refusal(recording).what == "data section: CRC mismatch; quarantined"


def test_a_summary_that_disagrees_is_ignored_with_a_warning(tmp_path, recording, rewrite, trace, same_trace, caplog):
    other = bytearray(recording.read_bytes())
    footer = len(other) - len(MAGIC) - 29
    start, _, _ = struct.unpack_from("<QQI", other, footer + 9)
    at = start
    while other[at] != Op.STATISTICS:
        at += 9 + struct.unpack_from("<Q", other, at + 1)[0]
    struct.pack_into("<Q", other, at + 9, 560)
    struct.pack_into("<I", other, footer + 25, zlib.crc32(other[start : footer + 25]))
    recording.write_bytes(other)
    with caplog.at_level(logging.WARNING):
        same_trace(read_episode(recording)[1], trace())
    assert caplog.messages == [f"{recording}: summary lists 560 messages, data has 905; summary ignored"]


def test_a_cut_in_the_summary_loses_nothing(recording, trace, same_trace, caplog):
    recording.write_bytes(recording.read_bytes()[:-50])
    with caplog.at_level(logging.WARNING):
        same_trace(read_episode(recording)[1], trace())
    assert "summary is damaged" in caplog.text


def test_a_chunk_that_declares_too_much(recording):
    data = bytearray(recording.read_bytes())
    at = chunk_at(data)
    struct.pack_into("<Q", data, at + 9 + 16, 2147483648)
    recording.write_bytes(data)
    assert refusal(recording).what == f"chunk at byte {at} declares 2147483648 B, limit 67108864"


def test_a_record_of_absurd_length(recording):
    data = bytearray(recording.read_bytes())
    at = chunk_at(data)
    struct.pack_into("<Q", data, at + 1, 2**63)
    recording.write_bytes(data)
    assert refusal(recording).what == f"chunk at byte {at} declares {2**63} B, limit 67108864"


def bomb(packed: bytes, declared: int, copies: int = 1) -> bytes:
    content = struct.pack("<QQQI", 0, 0, declared, 1) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
    content += packed
    header = struct.pack("<BQ", Op.HEADER, 8) + bytes(8)
    return MAGIC + header + (struct.pack("<BQ", Op.CHUNK, len(content)) + content) * copies


@pytest.mark.parametrize(("data", "message"), [
    (lambda: bomb(zstandard.compress(bytes(64 << 20), 1), 64 << 20), "declares 67108864 B out of .* limit 1000 to 1"),
    (lambda: bomb(bytes(70_000), 64 << 20, 20), "declare .* B together, limit 268435456"),
    (lambda: bomb(zstandard.compress(bytes(99 << 20), 1), 1000), r"header says 1000 B, zstd frame says 103809024 B"),
    (lambda: bomb(zstandard.ZstdCompressor(write_content_size=False).compress(bytes(99 << 20)), 1000), "is damaged: "),
], ids=["ratio", "sum", "lying header", "hidden size"])
def test_a_bomb_ends_at_once(tmp_path, data, message):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data())
    start = time.process_time()
    with pytest.raises(RecordingError, match=message):
        read_frames(path)
    assert time.process_time() - start < 5


@pytest.mark.parametrize(("name", "column", "value", "message"), [
    ("action", 3, np.nan, "action[3] is NaN at frame 17, /command/ee"),
    ("joint_action", 6, np.inf, "action.joint[6] is Inf at frame 17, /joint_commands"),
    ("state", 8, np.nan, "observation.state[8] is NaN at frame 17, /ee/measured"),
    ("environment", 0, -np.inf, "observation.environment_state[0] is Inf at frame 17, /observation/environment"),
])
def test_values_that_are_not_finite(tmp_path, trace, episode, name, column, value, message):
    rows = getattr(trace(), name).copy()
    rows[17, column] = value
    write_episode(tmp_path / "a.mcap", episode(), dataclasses.replace(trace(), **{name: rows}), attachments={})
    error = refusal(tmp_path / "a.mcap")
    assert error.what == message
    assert error.mend == "drop the episode: it cannot be trained on"


def changed(recording, rewrite, change) -> RecordingError:
    recording.write_bytes(rewrite(recording.read_bytes(), change))
    return refusal(recording)


def swap(topic: str, payload: bytes):
    return lambda name, m: dataclasses.replace(m, data=payload) if name == topic else m


@pytest.mark.parametrize(("topic", "payload", "message"), [
    ("/command/ee", cdr.multi_array("a", 11).template, "action has 11 values, robot 'arm' expects 5"),
    ("/joint_commands", cdr.joint_state(JOINT_NAMES[:6], velocity=False, effort=False).template,
     "action.joint has 6 values, robot 'arm' expects 7"),
    ("/observation/environment", cdr.multi_array("a", 6).template,
     "observation.environment_state has 6 values, robot 'arm' expects 7"),
], ids=["action", "joints", "environment"])
def test_a_wrong_shape_names_the_robot(recording, rewrite, topic, payload, message):
    error = changed(recording, rewrite, swap(topic, payload))
    assert (error.what, error.mend) == (message, "record with the robot that the recipe names")
    assert error.where.endswith(topic)


def test_joints_of_another_name(recording, rewrite):
    names = (*JOINT_NAMES[:5], "wrist", "gripper")
    payload = cdr.joint_state(names, velocity=True, effort=True).template
    error = changed(recording, rewrite, swap("/joint_states", payload))
    assert "names joints joint1, joint2, joint3, joint4, joint5, wrist, gripper" in error.what
    assert "joint6, gripper in this order" in error.mend


@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\0\0\0" + bytes(90), b"\0\1\0\0" + b"\xff" * 90],
                         ids=["empty", "only a header", "big endian", "absurd counts"])
@pytest.mark.parametrize("topic", ["/joint_states", "/command/ee"])
def test_payloads_that_are_no_message(recording, rewrite, topic, payload):
    assert f"message 0 on {topic} is damaged" in changed(recording, rewrite, swap(topic, payload)).what


@pytest.mark.parametrize("topic", ["/joint_states", "/ee/commanded", "/observation/environment"])
def test_a_missing_topic(recording, rewrite, topic):
    error = changed(recording, rewrite, lambda name, m: None if name == topic else m)
    assert error.what == f"topic {topic}, required by contract 'arm', is missing"


def test_time_that_goes_back(recording, rewrite):
    error = changed(recording, rewrite, lambda name, m: dataclasses.replace(m, log_time=m.log_time - 1_250_000_000)
                    if (name, m.sequence) == ("/joint_states", 40) else m)
    assert error.what == "/joint_states goes back 1.2 s at message 40"
    assert "one monotonic clock" in error.mend


def test_a_gap(recording, rewrite):
    error = changed(recording, rewrite, lambda name, m: None if (name, m.sequence) == ("/command/ee", 7) else m)
    assert error.what == "/command/ee skips to tick 8 at message 7"


def test_a_file_without_data_crc_is_not_trusted(recording):
    data = bytearray(recording.read_bytes())
    at = len(MAGIC)
    while data[at] != Op.DATA_END:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    data[at + 9 : at + 13] = bytes(4)
    recording.write_bytes(data)
    assert "enable_data_crcs=True" in refusal(recording).mend


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.mcap")
    assert refusal(tmp_path / "a.mcap").what == "not a regular file"


def test_well_sealed_nonsense_is_refused_or_read_but_never_breaks_the_reader(recording, rewrite):
    """What a hostile writer sends: every CRC right, the messages wrong."""
    data, rng, refused = recording.read_bytes(), np.random.default_rng(11), 0
    topics = ("/joint_states", "/tf", "/sim/state", "/task/phase", "/events", "/command/ee", "/reward/reach",
              "/policy/0123456789abcdef/disagreement", "/policy/0123456789abcdef/joint_commands", "/ee/measured")
    for _ in range(150):
        victim, kind, tick = topics[rng.integers(len(topics))], int(rng.integers(0, 7)), int(rng.integers(0, 60))

        def change(topic, m, victim=victim, kind=kind, tick=tick):
            if topic != victim or (kind < 5 and m.sequence != tick and tick % 2):
                return m
            payload = bytearray(m.data)
            at = int(rng.integers(4, max(5, len(payload))))
            match kind:
                case 0:
                    payload[at : at + 4] = rng.bytes(len(payload[at : at + 4]))
                case 1:
                    payload = payload[:at]
                case 2:
                    payload[4:12] = rng.bytes(8)
                case 3:
                    payload += rng.bytes(40)
                case 4:
                    return dataclasses.replace(m, sequence=int(rng.integers(0, 2**32)))
                case 5:
                    return None
                case _:
                    payload[4:] = bytes(len(payload) - 4)
            return dataclasses.replace(m, data=bytes(payload))

        recording.write_bytes(rewrite(data, change))
        try:
            read_episode(recording)
        except RecordingError as error:
            refused += 1
            assert error.mend and "\n" not in error.what
    assert refused > 75


def mutant(data: bytes, rng: np.random.Generator) -> bytes:
    """One fault of the kinds that disks, cables and people make."""
    out, at = bytearray(data), int(rng.integers(0, len(data)))
    size = int(rng.integers(1, 2000))
    match int(rng.integers(0, 7)):
        case 0:
            out[at] ^= 1 << int(rng.integers(0, 8))
        case 1:
            out[at : at + size] = bytes(len(out[at : at + size]))
        case 2:
            del out[at : at + size]
        case 3:
            out[at:at] = out[at : at + size]
        case 4:
            del out[at:]
        case 5:
            out[at : at + 8] = rng.bytes(len(out[at : at + 8]))
        case _:
            other = int(rng.integers(0, len(data)))
            out[at : at + size] = data[other : other + len(out[at : at + size])]
    return bytes(out)


def test_no_mutant_is_read_with_a_silent_difference(tmp_path, trace, episode, attachments, same_trace):
    path, written = tmp_path / "a.mcap", trace(200, nstate=40, k=10)
    digest = write_episode(path, episode(200), written, attachments=attachments)
    data, rng = path.read_bytes(), np.random.default_rng(20260101)
    refused, start = 0, time.process_time()
    for number in range(200):
        path.write_bytes(mutant(data, rng))
        try:
            found, back = read_episode(path)
        except RecordingError as error:
            refused += 1
            assert str(path) in str(error) and error.mend, f"mutant {number}"
            continue
        same_trace(back, written)
        assert found.model_copy(update={"blob": digest}) == episode(200).model_copy(update={"blob": digest})
    assert 150 < refused < 200, "some faults hit only the summary, most the data"
    assert time.process_time() - start < 20


def test_what_is_kept_of_a_mutant_is_a_prefix(tmp_path, trace, episode, attachments):
    path, written = tmp_path / "a.mcap", trace(700)
    write_episode(path, episode(700), written, attachments=attachments)
    data, rng = path.read_bytes(), np.random.default_rng(7)
    kept = 0
    for _ in range(200):
        path.write_bytes(mutant(data, rng))
        try:
            found, back = read_episode(path, accept_truncated=True)
        except RecordingError:
            continue
        kept += found.frames < 700
        n = found.frames
        for name in ("state", "environment", "action", "joint_action", "sim_state", "controller", "link_poses"):
            assert getattr(back, name).tobytes() == getattr(written, name)[:n].tobytes()
        assert back.phase == written.phase[:n]
        assert found.scene == episode(700).scene
        assert found.outcome == episode(700).outcome if n == 700 else found.outcome.label == "unknown"
    assert kept > 20
