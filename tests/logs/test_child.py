"""Files that nobody trusts, read in children: whatever happens there, one error that names file, limit and mend."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from pipeline.errors import ConfigError, RecordingError
from pipeline.logs.child import Children, Limits
from pipeline.logs.inspection import inspect, inspect_here
from pipeline.recipes import load_recipe
from pipeline.recording.quarantine import note_refused, set_aside

EPOCH_NS = 1_700_000_000_000_000_000


def log(path: Path, messages: int = 100, size: int = 20) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=32 << 20, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("a/B", "jsonschema", b"{}"))
        empty = writer.register_channel("/empty", "cdr", 0)
        assert empty
        writer.add_message(channel, 0, b"latched", 0)
        body = bytes(size)
        for k in range(messages):
            writer.add_message(channel, EPOCH_NS + k * 10_000_000, body, EPOCH_NS, k)
        writer.add_attachment(0, 0, "robot.urdf", "application/xml", b"<robot/>")
        writer.add_metadata("site", {"plant": "7"})
        writer.finish()
    return path


def hostile(path: Path, chunks: int = 3000) -> Path:
    """Half a megabyte that unpacks to 3 GB of the smallest messages there are."""
    tiny = struct.pack("<BQHIQQ", 5, 22, 1, 0, 1, 1) * 33_000
    packed = zstandard.compress(tiny)
    chunk = struct.pack("<QQQII", 1, 1, len(tiny), zlib.crc32(tiny), 4) + b"zstd" + struct.pack("<Q", len(packed))
    channel = struct.pack("<HH", 1, 0) + (struct.pack("<I", 1) + b"x") * 2 + bytes(4)
    parts = [(1, bytes(8)), (4, channel), *[(6, chunk + packed)] * chunks]
    path.write_bytes(b"\x89MCAP0\r\n" + b"".join(struct.pack("<BQ", op, len(c)) + c for op, c in parts))
    return path


def test_what_a_log_holds_is_told(tmp_path):
    seen = inspect(log(tmp_path / "a.mcap"))
    a, empty = seen.channels
    assert (a.topic, a.encoding, a.schema_name, a.schema_encoding) == ("/a", "json", "a/B", "jsonschema")
    assert (a.messages, a.bytes, a.latched, a.first_ns, a.last_ns) == (101, 2007, 1, EPOCH_NS, EPOCH_NS + 990_000_000)
    assert (empty.topic, empty.messages, empty.first_ns) == ("/empty", 0, 0)
    assert (seen.messages, seen.seconds, seen.problems) == (101, 0.99, ())
    assert (seen.attachments, seen.metadata) == ((("robot.urdf", 8),), ("site",))


def test_a_cut_log_is_refused_or_told(tmp_path):
    path = log(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:-800])
    with Children() as children:
        with pytest.raises(RecordingError, match="pass --accept-truncated to keep it"):
            inspect(path, children=children)
        assert inspect(path, accept_truncated=True, children=children).problems[0].kind == "damage"


def test_a_hostile_file_ends_within_its_limits_and_the_next_file_is_read(tmp_path):
    with Children() as children:
        good = inspect(log(tmp_path / "good.mcap"), children=children)
        with pytest.raises(RecordingError) as error:
            inspect(hostile(tmp_path / "bomb.mcap"), children=children)
        (child,) = running()
        assert sum(map(int, Path(f"/proc/{child}/stat").read_text().split()[13:15])) / os.sysconf("SC_CLK_TCK") < 5
        peak = next(x for x in Path(f"/proc/{child}/status").read_text().splitlines() if x.startswith("VmPeak"))
        assert int(peak.split()[1]) < 512 << 10
        assert "declare more than" in error.value.what and str(tmp_path / "bomb.mcap") in error.value.where
        assert inspect(tmp_path / "good.mcap", children=children) == good


@pytest.mark.parametrize(("limits", "message"), [
    (Limits(memory_bytes=140 << 20), "takes more than 140 MiB of memory to read; quarantined"),
    (Limits(cpu_s=0.05), "takes more than 0.05 s of CPU time to read; quarantined"),
    (Limits(wall_s=0.05), "takes more than 0.05 s of wall time to read; quarantined"),
], ids=["memory", "CPU", "wall"])
def test_each_limit_is_told_and_the_child_replaced(tmp_path, limits, message):
    big = log(tmp_path / "big.mcap", 8, 4 << 20) if limits.memory_bytes < 512 << 20 else hostile(tmp_path / "big", 40)
    with Children() as children:
        for _ in range(2):
            with pytest.raises(RecordingError) as error:
                children.call(inspect_here, str(big), True, where=big, limits=limits)
            assert error.value.what == message and error.value.where == str(big)
            assert "do not open it elsewhere" in error.value.mend and "mcap filter" in error.value.mend
        assert children.call(inspect_here, str(big), True, where=big)["channels"]


def test_a_child_that_is_killed_is_told_and_replaced(tmp_path):
    big = hostile(tmp_path / "big", 120)
    with Children() as children:
        inspect(log(tmp_path / "a.mcap"), children=children)
        (pid,) = running()
        threading.Timer(0.2, os.kill, (pid, signal.SIGSEGV)).start()
        with pytest.raises(RecordingError) as error:
            inspect(big, accept_truncated=True, children=children)
        assert error.value.what == "the process that read it died (SIGSEGV); quarantined"
        assert "report it" in error.value.mend
        assert inspect(tmp_path / "a.mcap", children=children).messages == 101
    assert running() == []


def running(parent: int | None = None) -> list[int]:
    """Children of ours that are alive."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and b"pipeline.logs.worker" in (entry / "cmdline").read_bytes():
                ppid = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                if ppid == (parent or os.getpid()):
                    found.append(int(entry.name))
        except OSError:
            continue
    return found


def test_many_files_come_in_order_and_the_bad_ones_as_errors(tmp_path):
    files = [log(tmp_path / f"{k}.mcap", k) for k in range(6)]
    files[3].write_bytes(b"nonsense")
    with Children(2) as children:
        results = list(children.map(inspect_here, files, False))
    assert isinstance(results[3], RecordingError) and "not an MCAP file" in results[3].what
    assert [r["channels"][0]["messages"] for k, r in enumerate(results) if k != 3] == [1, 2, 3, 5, 6]


def test_an_error_of_ours_keeps_its_kind_and_a_fault_is_told(tmp_path):
    with Children() as children:
        with pytest.raises(ConfigError, match="use one of"):
            children.call(load_recipe, "nonesuch", where=tmp_path)
        with pytest.raises(RecordingError) as error:
            children.call(inspect_here, None, where=tmp_path / "a.mcap")
        assert error.value.what.startswith("cannot be read: TypeError") and "report it" in error.value.mend
        with pytest.raises(RecordingError, match="is not ours"):
            children.call(log, str(tmp_path), where=tmp_path)


ORPHAN = """
import os, sys
from pathlib import Path
from pipeline.logs.child import Children
from pipeline.logs.inspection import inspect
with Children() as children:
    inspect(Path(sys.argv[1]), children=children)
    print("ready", flush=True)
    sys.stdin.read()
"""


def test_children_end_when_their_parent_is_killed(tmp_path):
    command = [sys.executable, "-c", ORPHAN, str(log(tmp_path / "a.mcap"))]
    parent = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert parent.stdout and parent.stdout.readline() == b"ready\n"
    (child,) = running(parent.pid)
    parent.kill()
    parent.wait()
    for _ in range(100):
        if not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().rpartition(")")[2][:3]:
            return
        time.sleep(0.05)
    pytest.fail("the child is still there")


def test_limits_grow_with_the_file(tmp_path):
    with (tmp_path / "big.mcap").open("wb") as stream:
        stream.truncate(5 << 30)
    assert Limits.of(tmp_path / "big.mcap").cpu_s > 600
    assert Limits.of(tmp_path / "none.mcap").cpu_s < 5


def test_a_file_is_set_aside_with_its_reason_and_replaces_nothing(tmp_path):
    for number in range(3):
        (tmp_path / "a.mcap").write_bytes(bytes([number]))
        set_aside(tmp_path / "a.mcap", f"reason {number}")
    folder = tmp_path / "quarantine"
    assert [(folder / name).read_bytes()[0] for name in ("a.mcap", "a.mcap.1", "a.mcap.2")] == [0, 1, 2]
    assert (folder / "a.mcap.reason.txt").read_text() == "reason 0\n"
    assert (folder / "a.mcap.2.reason.txt").read_text() == "reason 2\n"
    assert not (tmp_path / "a.mcap").exists()


def test_a_refusal_is_noted_once_and_the_file_stays(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"nonsense")
    with pytest.raises(RecordingError) as error:
        inspect(path)
    notes = {note_refused(path, error.value, tmp_path / "notes") for _ in range(2)}
    (note,) = notes
    assert path.read_bytes() == b"nonsense"
    assert note.read_text() == f"{error.value}\n" and "not an MCAP file" in note.read_text()
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="make it writable"):
        note_refused(path, error.value, tmp_path / "file")
    with pytest.raises(RecordingError, match="writable, or move the file by hand"):
        set_aside(path, "reason", folder=tmp_path / "file" / "x")
