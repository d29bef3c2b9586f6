"""hardcase ingest, whole: foreign logs into the store, converted once, and into versions that lerobot opens."""

import json
import shutil
import struct
import subprocess
import sys
import zlib
from datetime import date
from pathlib import Path

import pytest
import yaml
import zstandard

from flows.data.ingesting import Ingest
from pipeline.files import sha256_file
from pipeline.logs.cameras import Images
from pipeline.logs.child import Limits
from pipeline.store import Store
from pipeline.store.gc import unreferenced
from schemas.consent import Consent

JOINTS, IMAGE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage"
REAL = Path(__file__).parents[3] / "shared/logs"
MAP = {
    "name": "theirs", "robot": "g1", "task": "walk to the door", "fps": 20,
    "features": {"observation.state": {"topic": "/joints", "fields": ["position"], "joints": ["hip", "knee"]},
                 "action": {"topic": "/cmd", "fields": ["data"], "resample": "nearest"}},
    "episodes": {"by": "gap", "longer_than_s": 1},
    "consent": "form-1", "operator": "op-7", "site": "lab-2",
}


@pytest.fixture
def store(tmp_path, monkeypatch):
    """An empty store with the consent of op-7."""
    root = tmp_path / "store"
    monkeypatch.setenv("HARDCASE_STORE", str(root))
    with Store.open(root, create=True) as opened:
        opened.add_consent(Consent(id="form-1", operator="op-7", site="lab-2", purposes=("training",),
                                   given=date(2020, 1, 1), expires=date(2099, 1, 1)))
    return root


@pytest.fixture
def ingest(store, tmp_path, hardcase):
    """The command line in this process: exit code, standard output (read, if it is JSON), standard error."""

    def call(*arguments, declared=MAP):
        if declared is not None:
            (tmp_path / "map.yaml").write_text(yaml.safe_dump(declared, sort_keys=False))
            arguments = (*arguments, "--map", tmp_path / "map.yaml")
        code, out, err = hardcase("ingest", *arguments)
        return code, json.loads(out) if "--json" in arguments else out, err

    return call


@pytest.fixture
def walk(foreign_log, tmp_path):
    """A log of three walks with a camera; `name` and `scale` make another one."""

    def make(name="a.mcap", scale=1.0, values=2):
        with foreign_log() as log:
            for start in (0, 5, 10):
                for k in range(41):
                    t = start + k / 20
                    stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
                    log.ros("/joints", JOINTS, t, {"header": stamp, "name": ["knee", "hip"], "velocity": [],
                                                   "effort": [], "position": [scale * t, -t]})
                    log.json("/cmd", t, {"data": [t] * values})
                    if k % 2 == 0:
                        log.ros("/cam", IMAGE, t, {"header": stamp, "format": "jpeg",
                                                   "data": b"\xff\xd8\xff" + bytes([k]) * 100})
        return shutil.move(log.path, tmp_path / name)

    return make


def bomb(path: Path) -> Path:
    """64 KB that unpack to gigabytes."""
    tiny = struct.pack("<BQHIQQ", 5, 22, 1, 0, 1, 1) * 33_000
    packed = zstandard.compress(tiny)
    chunk = struct.pack("<QQQII", 1, 1, len(tiny), zlib.crc32(tiny), 4) + b"zstd" + struct.pack("<Q", len(packed))
    channel = struct.pack("<HH", 1, 0) + (struct.pack("<I", 1) + b"x") * 2 + bytes(4)
    parts = [(1, bytes(8)), (4, channel), *[(6, chunk + packed)] * 3000]
    path.write_bytes(b"\x89MCAP0\r\n" + b"".join(struct.pack("<BQ", op, len(c)) + c for op, c in parts))
    return path


def slow(path: Path) -> Path:
    """2 MB, valid but for its end: a million messages, no two neighbours of one channel."""
    rest = struct.pack("<I", 1) + b"x" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    channels = b"".join(struct.pack("<BQHH", 4, 4 + len(rest), k, 0) + rest for k in range(60_000))
    plain = b"".join(struct.pack("<BQHIQQ", 5, 22, k % 60_000, 0, 1, 1) for k in range(200_000))
    packed = zstandard.compress(plain)
    chunk = struct.pack("<QQQII", 1, 1, len(plain), zlib.crc32(plain), 4) + b"zstd" + struct.pack("<Q", len(packed))
    chunk = struct.pack("<BQ", 6, len(chunk + packed)) + chunk + packed
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 8) + bytes(8) + channels + chunk * 12)
    return path


def test_a_log_becomes_a_version_that_lerobot_opens(ingest, walk, store, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    log = walk()
    before = sha256_file(log)
    code, told, _ = ingest(log, "--dataset", "walks", "--json", declared=MAP | {"cameras": {"head": {"topic": "/cam"}}})
    assert code == 0
    assert sha256_file(log) == before == sha256_file(store / "blobs" / told["logs"][0]["sha256"])
    assert [s["frames"] for s in told["logs"][0]["spans"]] == [41, 41, 41]
    assert told["dataset"]["cameras_waiting"] == ["head"]

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    data = LeRobotDataset("test/walks", root=told["dataset"]["folder"])
    assert (data.num_episodes, data.num_frames, data.fps, data.meta.robot_type) == (3, 123, 20, "g1")
    assert data.meta.features["observation.state"]["names"] == ["hip", "knee"]
    row = data[45]
    assert row["observation.state"].tolist() == pytest.approx([-5.2, 5.2])
    assert row["task"] == "walk to the door"
    assert abs(row["skew.action"].item()) < 1e-6
    notes = json.loads((Path(told["dataset"]["folder"]) / "meta/hardcase.json").read_text())["ingested"]
    (waiting,) = notes["cameras_waiting"]["head"]
    assert len(Images(store / "blobs" / waiting["images"])) == 63


def test_only_what_changed_is_done_again_and_the_old_result_stays(ingest, walk, store):
    logs = [walk("a.mcap"), walk("b.mcap", scale=2.0)]
    first = ingest(*logs, "--json")[1]["logs"]
    again = ingest(*logs, "--json")[1]["logs"]
    assert [log["kept"] for log in (*first, *again)] == [False, False, True, True]
    assert [log["episodes"] for log in again] == [log["episodes"] for log in first]

    labelled = ingest(*logs, "--json", declared=MAP | {"site": "lab-3"})[1]["logs"]
    assert [log["kept"] for log in labelled] == [True, True]  # a label converts nothing
    assert labelled[0]["files"] == first[0]["files"]
    assert labelled[0]["episodes"] != first[0]["episodes"]

    slower = ingest(*logs, "--json", declared=MAP | {"fps": 10})[1]["logs"]
    assert [log["kept"] for log in slower] == [False, False]
    with Store.open(store) as opened:
        assert len(opened.conversions(first[0]["sha256"])) == 2
        assert opened.blob(first[0]["files"]["frames"]).is_file()
        assert opened.verify() == []
        assert [p for p in unreferenced(opened, grace_s=0).pieces if p.kind == "blob"] == []


def test_images_are_not_taken_again_when_only_the_features_change(ingest, walk, store, tmp_path):
    declared = MAP | {"cameras": {"head": {"topic": "/cam"}}}
    log = walk()
    first = ingest(log, "--json", declared=declared)[1]["logs"][0]
    other = ingest(log, "--json", declared=declared | {"fps": 10})[1]["logs"][0]
    renamed = ingest(log, "--json", declared=MAP | {"cameras": {"front": {"topic": "/cam", "max_skew_s": 0.5}}}
                     )[1]["logs"][0]
    assert other["files"]["camera.head"] == renamed["files"]["camera.front"] == first["files"]["camera.head"]
    assert other["cameras"] == first["cameras"] == {"head": {"images": 63, "format": "jpeg", "left_out": {}}}
    assert first["skews"]["camera.head"] == renamed["skews"]["camera.front"]
    shutil.rmtree(store)
    afresh = ingest(log, "--json", declared=declared | {"fps": 10})[1]["logs"][0]
    assert afresh["files"] == other["files"]  # what was kept changed no byte


def test_rebuilding_in_another_store_gives_the_same_bytes(ingest, walk, tmp_path, monkeypatch):
    log = walk()
    first = ingest(log, "--json", declared=MAP)[1]["logs"][0]
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "elsewhere"))
    second = ingest(log, "--json", declared=MAP)[1]["logs"][0]
    assert (second["kept"], second["files"], second["episodes"]) == (False, first["files"], first["episodes"])


def test_bad_logs_are_set_aside_with_the_reason_and_the_others_go_on(ingest, walk, store, tmp_path):
    good, cut = walk("good.mcap"), tmp_path / "cut.mcap"
    cut.write_bytes(good.read_bytes()[:-2000])
    (tmp_path / "text.mcap").write_text("hello")
    code, told, _ = ingest(tmp_path / "text.mcap", bomb(tmp_path / "bomb.mcap"), cut, good, "--json")
    text, evil, short, fine = told["logs"]
    assert code == 2
    assert (text["state"], text["reason"]) == ("refused", "not an MCAP file (bad magic at byte 0)")
    assert evil["state"] == short["state"] == "quarantined"
    assert "ends early after message" in short["reason"]
    assert "--accept-truncated" in short["mend"]
    assert (fine["state"], len(fine["episodes"])) == ("converted", 3)
    assert {f.name for f in (store / "quarantine").iterdir()} == {"bomb.mcap.reason.txt", "cut.mcap.reason.txt"}
    again = ingest(bomb(tmp_path / "bomb.mcap"), good, "--json")[1]["logs"][0]
    assert (again["state"], again["kept"]) == ("quarantined", True)  # nobody opens it twice

    code, told, _ = ingest(cut, "--accept-truncated", "--json")
    assert code == 0
    assert 1 <= len(told["logs"][0]["episodes"]) <= 3
    assert any("ends early" in p for p in told["logs"][0]["problems"])


@pytest.mark.parametrize("command", [("ingest", "--accept-truncated"), ("check",)], ids=lambda c: c[0])
def test_a_file_that_wants_time_ends_in_either_command_within_5_s_and_512_mib(store, tmp_path, command):
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP))
    declared = ["--map", str(tmp_path / "map.yaml")] if command[0] == "ingest" else []
    code = ("import resource, sys; from flows.cli import app\ntry: app(sys.argv[1:], standalone_mode=False)\n"
            "except BaseException as ended: print(getattr(ended, 'what', ''))\n"
            "used = resource.getrusage(resource.RUSAGE_CHILDREN); print(used.ru_utime + used.ru_stime, used.ru_maxrss)")
    done = subprocess.run([sys.executable, "-c", code, *command, str(slow(tmp_path / "slow.mcap")), *declared],
                          capture_output=True, text=True)
    assert "time to read; quarantined" in done.stdout + done.stderr
    seconds, kilobytes = map(float, done.stdout.splitlines()[-1].split())
    assert seconds < 5 and kilobytes < 512 << 10


def test_a_log_that_a_busy_machine_was_too_slow_for_is_tried_again(ingest, walk, store, monkeypatch):
    log = walk()
    with monkeypatch.context() as busy:
        busy.setattr("stages.ingest._limits", lambda log: Limits(cpu_s=100, wall_s=0.01))
        code, told, _ = ingest(log, "--json")
    assert (code, told["logs"][0]["state"]) == (2, "quarantined")
    assert "of wall time to read" in told["logs"][0]["reason"]
    code, told, _ = ingest(log, "--json")
    assert (code, told["logs"][0]["state"], told["logs"][0]["kept"]) == (0, "converted", False)


@pytest.mark.parametrize(("make", "line", "mend"), [
    (lambda p, walk: p.write_bytes(b""), "not an MCAP file (bad magic at byte 0)", "name MCAP recordings"),
    (lambda p, walk: p.write_bytes(walk("b.mcap").read_bytes()[:-9000]), "ends early after message",
     "accept-truncated"),
    (lambda p, walk: None, "cannot be read: No such file or directory", "name MCAP recordings"),
], ids=["empty", "cut off", "not there"])
def test_a_bad_log_alone_is_one_line_and_exit_code_2(ingest, walk, tmp_path, make, line, mend):
    make(tmp_path / "bad.mcap", walk)
    code, out, err = ingest(tmp_path / "bad.mcap")
    what, at, to_do = err.strip().split("\n")
    assert (code, out) == (2, "")
    assert line in what
    assert "bad.mcap" in at
    assert mend in to_do


def test_a_name_that_no_version_can_have_is_refused_before_anything_is_read(ingest, walk, store):
    code, _, err = ingest(walk(), "--dataset", "My Walks")
    assert code == 2
    assert "not a valid dataset: 'My Walks'" in err
    assert "use 1 to 64 of a-z" in err
    assert list((store / "blobs").iterdir()) == []


def test_a_folder_without_logs_is_refused(ingest, tmp_path):
    (tmp_path / "logs").mkdir()
    code, _, err = ingest(tmp_path / "logs")
    assert code == 2
    assert "no .mcap file in it" in err
    assert "name MCAP recordings" in err


def test_without_a_map_the_way_to_one_is_told(ingest, walk):
    code, _, err = ingest(walk(), declared=None)
    assert code == 2
    assert "hardcase ingest --suggest" in err


def test_without_a_consent_that_holds_an_episode_is_stored_and_reaches_no_version(ingest, walk, store):
    log = walk()
    code, told, _ = ingest(log, "--json", declared={k: v for k, v in MAP.items() if k != "consent"})
    assert (code, len(told["logs"][0]["episodes"])) == (0, 3)
    nobody = {k: v for k, v in MAP.items() if k != "consent"}
    for declared in (nobody, MAP | {"consent": "form-9"}, MAP | {"operator": "op-8"}):
        code, _, err = ingest(log, "--dataset", "walks", declared=declared)
        assert code == 2
        assert "it cannot be used for training" in err
        assert "leave the episode out" in err
    assert list((store / "versions").iterdir()) == []


def test_a_failure_teaches_nothing_and_is_told(ingest, walk):
    code, _, err = ingest(walk(), "--dataset", "walks", declared=MAP | {"outcome": {"label": "failure"}})
    assert code == 2
    assert "none of 3 episodes may be learnt from (3 failure)" in err


def test_a_log_that_failed_its_check_teaches_nothing(ingest, walk, hardcase):
    log = walk()
    episode = ingest(log, "--json")[1]["logs"][0]["episodes"][0]
    code, out, _ = hardcase("check", episode)  # finds its raw log, whose pictures show nothing
    assert code == 1
    assert "black-camera" in out
    code, _, err = ingest(log, "--dataset", "walks")
    assert code == 2
    assert "none of 3 episodes may be learnt from (3 failed a check)" in err


def test_logs_of_other_shapes_do_not_become_one_version(ingest, walk):
    code, _, err = ingest(walk("a.mcap"), walk("b.mcap", values=3), "--dataset", "walks")
    assert code == 2
    assert "action has 3 values, robot 'g1' expects 2" in err
    assert "one version for each set of features" in err


def test_why_leads_back_to_the_raw_log_and_forward_from_it(ingest, walk, store, hardcase):
    told = ingest(walk(), "--dataset", "walks", "--json")[1]
    log = told["logs"][0]
    for asked, expected in ((log["episodes"][0], log["sha256"]), (told["dataset"]["version"], log["sha256"]),
                            (log["sha256"][:12], told["dataset"]["version"])):
        assert expected in hardcase("why", asked)[1]


def test_a_stretch_of_a_log_never_stands_on_both_sides_of_a_split(ingest, walk):
    log = walk()
    held = [ingest(log, "--dataset", "walks", "--json", declared=MAP | more)[1] for more in ({}, {"fps": 10})]
    spans = [[log["spans"][k]["boundary"] for k in range(3)] for log in (h["logs"][0] for h in held)]
    assert spans[0] == spans[1] == [0, 1, 2]
    sides = []
    for told in held:
        manifest = json.loads((Path(told["dataset"]["folder"]) / "meta/hardcase.json").read_text())
        sides.append([e in manifest["version"]["held_out"] for e in manifest["version"]["episodes"]])
    assert sides[0] == sides[1]
    assert sum(sides[0]) == 1


def test_an_ingest_that_was_interrupted_goes_on_with_the_next_log(walk, store, tmp_path):
    from pipeline.logs.mapping import load_map

    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP))
    declared, logs = load_map(tmp_path / "map.yaml"), [walk("a.mcap"), walk("b.mcap", scale=3)]
    with Store.open(store) as opened:
        with Ingest(opened, declared) as work:
            work.take(logs[0])
        with Ingest(opened, declared) as work:
            assert [work.take(log).kept for log in logs] == [True, False]
        assert list(opened.tmp.iterdir()) == []


def test_the_table_tells_what_became_of_each_log(ingest, walk, tmp_path):
    code, out, _ = ingest(walk("a.mcap"), "--dataset", "walks")
    assert code == 0
    assert out.split("\n")[1].split() == ["a.mcap", "3", "123", "2", "/", "1", "/", "0", "0.0", "/", "0.0", "ms"]
    assert "3 episodes, 123 frames, 1 held out" in out


def test_a_suggested_map_ingests_the_log_it_was_made_from(ingest, walk, tmp_path):
    log = walk()
    _, suggested, _ = ingest(log, "--suggest", declared=None)
    code, told, _ = ingest(log, "--json", declared=yaml.safe_load(suggested))
    assert code == 0
    assert told["logs"][0]["spans"]


@pytest.mark.skipif(not REAL.is_dir(), reason="recordings of other projects are not here")
@pytest.mark.parametrize(("name", "features", "frames"), [
    ("rosbag2_cdr_test", {"a": {"topic": "/test_topic", "fields": ["float64_value", "int32_value"]}}, 2),
    ("rosbag2_talker", {"a": {"topic": "/rosout", "fields": ["level", "line"], "max_skew_s": 0.6}}, 46),
    ("rosbag2parquet_array_msgs", {"a": {"topic": "/one_shot/joint_state", "fields": ["position"]}}, 1),
])
def test_recordings_made_by_other_software_go_through(ingest, name, features, frames):
    declared = {"name": "real", "robot": "r", "task": "t", "fps": 10, "min_frames": 1, "features": features}
    code, told, _ = ingest(REAL / f"{name}.mcap", "--json", declared=declared)
    assert code == 0
    assert told["logs"][0]["frames"] == frames
