"""From somebody else's messages to frames: values, clocks, boundaries, holes, and logs that are odd but legal."""

import json
import struct

import numpy as np
import pytest
from google.protobuf import descriptor_pb2

from pipeline.errors import ConfigError
from pipeline.files import sha256_file
from pipeline.logs.cameras import Images
from pipeline.logs.convert import convert
from pipeline.logs.tables import FrameFile
from schemas.conversion import Converted
from schemas.ingest import IngestMap

JOINTS = "sensor_msgs/msg/JointState"
STATE = {"topic": "/joints", "fields": ["position"], "joints": ["shoulder", "elbow"]}
NS = 10**9


def declared(**fields):
    return IngestMap.model_validate({"name": "theirs", "robot": "g1", "task": "walk", "fps": 10,
                                     "features": {"observation.state": STATE}, **fields})


@pytest.fixture
def converted(tmp_path):
    """Converts a log in this process: the result, and the tables of its episodes."""

    def run(log, asked, name="out"):
        folder = tmp_path / name
        folder.mkdir()
        result = Converted.model_validate(convert(str(log), asked.model_dump_json(), str(folder)))
        frames = FrameFile(folder / "frames", result) if result.spans else None
        return result, [frames.table(k).columns() for k in range(len(result.spans))], folder

    return run


def state(shoulder, elbow, at=None, names=("elbow", "shoulder", "wrist")):
    values = {"shoulder": shoulder, "elbow": elbow, "wrist": 99.0}
    ns = 0 if at is None else 1_760_000_000 * NS + round(at * 1e9)
    return {"header": {"stamp": {"sec": ns // NS, "nanosec": ns % NS}, "frame_id": ""}, "name": list(names),
            "position": [values[n] for n in names], "velocity": [], "effort": []}


def joints(log, times, topic="/joints", **how):
    for t in times:
        log.ros(topic, JOINTS, t, state(t, -t, **how))


def at(times):
    return [round(float(t), 4) for t in times]


def test_joints_are_taken_by_name_whatever_order_each_message_has(foreign_log, converted):
    with foreign_log() as log:
        for k in range(10):
            names = ("elbow", "shoulder", "wrist") if k % 2 else ("wrist", "shoulder", "elbow")
            log.ros("/joints", JOINTS, k / 10, state(k, -k, names=names))
            log.ros("/joints", JOINTS, k / 10 + 0.01, {**state(0, 0), "name": ["gripper"], "position": [0.5]})
    result, (episode,), _ = converted(log.path, declared())
    assert episode["observation.state"].tolist() == [[k, -k] for k in range(10)]
    assert result.features["observation.state"] == ("shoulder", "elbow")
    assert result.topics[0].left_out == {"does not name joint 'shoulder'": 10}


def test_several_topics_stand_side_by_side_in_their_units_with_a_skew_each(foreign_log, converted):
    with foreign_log() as log:
        for k in range(10):
            log.ros("/joints", JOINTS, k / 10, state(180.0, 90.0))
            log.json("gripper", k / 10 + 0.02, {"width_mm": 40 + k})
    sources = [{**STATE, "unit": "deg_to_rad", "offset": [0.0, 1.0]},
               {"topic": "gripper", "fields": ["width_mm"], "unit": "mm_to_m", "scale": -1}]
    result, (episode,), _ = converted(log.path, declared(features={"observation.state": sources}))
    assert episode["observation.state"][3].tolist() == pytest.approx([np.pi, np.pi / 2 + 1, -0.043])
    assert result.features == {"observation.state": ("shoulder", "elbow", "width_mm"),
                               "skew.observation.state": ("/joints", "gripper")}
    assert episode["skew.observation.state"][3].tolist() == pytest.approx([0.02, 0.0])  # frame 0 waits for the gripper
    assert result.skews["observation.state"].max_s == pytest.approx(0.02)


def test_elements_are_taken_by_index_and_what_is_too_short_is_counted(foreign_log, converted):
    with foreign_log() as log:
        for k in range(20):
            log.json("/data", k / 20, {"v": list(range(k, k + (3 if k in (4, 5) else 8)))})
    asked = declared(features={"action": {"topic": "/data", "fields": ["v[5:7]", "v[0]"], "max_skew_s": 0.2}})
    result, (episode,), _ = converted(log.path, asked)
    assert episode["action"][:4].tolist() == [[5, 6, 0], [7, 8, 2], [8, 9, 3], [11, 12, 6]]
    assert result.features["action"] == ("v_5", "v_6", "v")
    assert result.topics[0].left_out == {"v[5:7] has 3 values, 7 were expected": 2}


@pytest.mark.parametrize(("clock", "lag_s"), [("log", 0.05), ("header", 0.0)])
def test_the_clock_that_is_declared_decides(foreign_log, converted, clock, lag_s):
    with foreign_log() as log:
        for k in range(20):  # recorded 0.07 s after it was measured
            log.ros("/joints", JOINTS, k / 20 + 0.07, state(k / 20, 0, at=k / 20))
            log.json("/truth", k / 20, {"t": k / 20})
    asked = declared(features={"a": {**STATE, "clock": clock}, "b": {"topic": "/truth", "fields": ["t"]}})
    _, (episode,), _ = converted(log.path, asked)
    assert at(episode["b"][:5, 0] - episode["a"][:5, 0]) == [lag_s] * 5


def test_header_stamps_that_were_never_set_are_named_with_the_mend(foreign_log, converted):
    with foreign_log() as log:
        joints(log, np.arange(0, 1, 0.1))
    with pytest.raises(ConfigError, match="all 10 messages of /joints have header time 0") as error:
        converted(log.path, declared(clock="header"))
    assert "declare another clock" in error.value.mend


def test_clocks_of_different_epochs_are_named(foreign_log, converted):
    with foreign_log() as log:
        for k in range(10):
            log.ros("/joints", JOINTS, k / 10, {**state(k, k), "header": {"stamp": {"sec": 5 + k, "nanosec": 0},
                                                                          "frame_id": ""}})
            log.json("/b", k / 10, {"x": k})
    asked = declared(features={"a": {**STATE, "clock": "header"}, "b": {"topic": "/b", "fields": ["x"]}})
    with pytest.raises(ConfigError, match=r"no time in common: /b begins 1.76e\+09 s after /joints ends, by log and "
                                          "header time"):
        converted(log.path, asked)


def test_a_header_clock_that_was_set_back_is_refused_and_a_recorder_out_of_order_is_put_in_order(foreign_log,
                                                                                                converted):
    times = [0, 0.1, 0.2, 0.3, 1.4, 0.4, 0.5, 0.6]
    with foreign_log() as log:
        for t in times:
            log.ros("/joints", JOINTS, t, state(t, 0, at=t))
    with pytest.raises(ConfigError, match="/joints goes back 1 s at message 5, by its header time"):
        converted(log.path, declared(clock="header"))
    result, (episode, last), _ = converted(log.path, declared(min_frames=1), name="by log")
    assert at(episode["observation.state"][:, 0]) == [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.6]
    assert at(last["observation.state"][:, 0]) == [1.4]
    assert any("out of order by up to 1 s" in p for p in result.problems)


def test_a_hole_parts_the_episode_and_is_named_or_refuses_it(foreign_log, converted):
    with foreign_log() as log:
        joints(log, [*np.arange(0, 1.01, 0.1), *np.arange(2, 3.01, 0.1)])
    result, episodes, _ = converted(log.path, declared())
    assert [(s.boundary, s.part, s.frames) for s in result.spans] == [(0, 0, 12), (0, 1, 11)]
    assert result.problems == ("episode 0 is parted at frame 12, 8 frames are missing: /joints has no sample within "
                               "0.1 s",)
    assert at(episodes[1]["observation.state"][:2, 0]) == [2.0, 2.1]
    refused, episodes, _ = converted(log.path, declared(missing="refuse"), name="refused")
    assert episodes == []
    assert "episode 0 is refused: frames are missing in it" in refused.problems


def test_nan_is_never_a_value_of_a_frame(foreign_log, converted):
    with foreign_log() as log:
        for k in range(10):
            log.ros("/joints", JOINTS, k / 10, state(float("nan") if k == 4 else k, k))
    result, episodes, _ = converted(log.path, declared(features={"action": STATE}))
    assert [len(e["action"]) for e in episodes] == [4, 5]
    assert result.problems[0].endswith("1 frames are missing: action[0] is NaN at frame 4, /joints")


def test_a_marker_topic_begins_and_ends_episodes_and_outcomes_follow(foreign_log, converted):
    with foreign_log() as log:
        for k in range(100):
            t = k / 20
            log.ros("/joints", JOINTS, t, state(t, 0))
            log.json("/rec", t, {"on": 0.5 <= t < 1.5 or 2 <= t < 3 or t >= 4.5})
        log.json("/result", 1.7, {"data": "ok"})
        log.json("/result", 3.2, {"data": "dropped"})
    asked = declared(episodes={"by": "marker", "topic": "/rec", "field": "on", "start": [True], "stop": [False]},
                     outcome={"topic": "/result", "success": ["ok"], "failure": ["dropped", "late"]})
    result, episodes, _ = converted(log.path, asked)
    assert [s.label for s in result.spans] == ["success", "failure", "unknown"]
    assert [(at(e["observation.state"][[0, -1], 0])) for e in episodes] == [[0.5, 1.5], [2, 3], [4.5, 4.9]]
    assert "/rec does not end episode 2; it goes on to the last sample" in result.problems


def test_silence_parts_episodes(foreign_log, converted):
    with foreign_log() as log:
        joints(log, [*np.arange(0, 1.01, 0.1), *np.arange(5.03, 6.01, 0.1)])
    result, episodes, _ = converted(log.path, declared(episodes={"by": "gap", "longer_than_s": 2}))
    assert [s.boundary for s in result.spans] == [0, 1]
    assert at(episodes[1]["observation.state"][:2, 0]) == [5.03, 5.13]
    assert result.problems == ()


def test_images_are_kept_as_they_came_and_each_frame_knows_its_own(foreign_log, converted):
    image = "sensor_msgs/msg/CompressedImage"
    with foreign_log() as log:
        for k in range(31):
            if k % 3 == 0:
                log.ros("/joints", JOINTS, k / 30, state(k / 30, 0))
            pixels = b"\xff\xd8\xff" + bytes([k]) * 50
            log.ros("/cam", image, k / 30, {"header": state(0, 0)["header"], "format": "jpeg", "data": pixels})
    result, (episode,), folder = converted(log.path, declared(cameras={"head": {"topic": "/cam"}}))
    images, used = Images(folder / "camera.head"), FrameFile(folder / "frames", result).images(0, "head")
    assert (len(images), result.cameras["head"].format) == (31, "jpeg")
    assert images[7] == b"\xff\xd8\xff" + bytes([7]) * 50
    assert used.tolist() == list(range(0, 31, 3))
    assert (images.stamps_ns()[used] - result.spans[0].start_ns).tolist() == pytest.approx(
        [k * NS / 10 for k in range(11)], abs=1)
    assert np.abs(episode["skew.camera.head"]).max() < 1e-6


def test_raw_images_keep_their_bytes_and_say_what_they_are(foreign_log, converted):
    with foreign_log() as log:
        joints(log, np.arange(0, 1, 0.1))
        for k in range(10):
            log.json("/raw", k / 10, {"encoding": "rgb8", "width": 4, "height": 2, "data": "AAAA" * 8},
                     name="sensor_msgs/msg/Image", encoding="jsonschema")
    result, _, folder = converted(log.path, declared(cameras={"wrist": {"topic": "/raw"}}))
    assert result.cameras["wrist"].format == "rgb8 4x2"
    assert Images(folder / "camera.wrist")[3] == bytes(24)


def test_protobuf_beside_other_encodings(foreign_log, converted):
    file = descriptor_pb2.FileDescriptorProto(name="tank.proto", package="plc", syntax="proto3")
    level = file.message_type.add(name="Tank").field.add(name="level", number=1)
    level.type, level.label = level.TYPE_DOUBLE, level.LABEL_OPTIONAL
    with foreign_log() as log:
        joints(log, np.arange(0, 1, 0.1))
        tank = log.channel("tank", "plc.Tank", "protobuf",
                           descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(), "protobuf")
        for k in range(10):
            log.put(tank, k / 10, b"\x09" + struct.pack("<d", k / 2))
    asked = declared(features={"observation.state": [STATE, {"topic": "tank", "fields": ["level"]}]})
    result, (episode,), _ = converted(log.path, asked)
    assert episode["observation.state"][4].tolist() == pytest.approx([0.4, -0.4, 2.0])
    assert {t.encoding for t in result.topics} == {"cdr", "protobuf"}


def test_one_reading_gives_the_same_bytes_as_another(foreign_log, converted):
    with foreign_log() as log:
        joints(log, np.arange(0, 5, 0.03))
    (_, _, first), (_, _, second) = (converted(log.path, declared(), name=n) for n in ("first", "second"))
    assert sha256_file(first / "frames") == sha256_file(second / "frames")


def test_odd_but_legal_logs_go_through_and_what_cannot_be_decoded_is_named_and_counted(foreign_log, converted):
    """No slash, no /msg/, a service event, a latched message at 0, JSON under a ROS name, strange encodings."""
    with foreign_log() as log:
        log.ros("joints", "sensor_msgs/JointState", None, state(-1, -1))
        service = log.channel("/srv", "std_srvs/srv/Trigger", "ros2msg", b"bool x\n---\nbool success\n", "cdr")
        strange = log.channel("/plc", "Plc", "ladder", b"?", "opcua")
        for k in range(10):
            log.ros("joints", "sensor_msgs/JointState", k / 10, state(k, -k))
            log.json("/json", k / 10, {"linear": {"x": k}}, name="geometry_msgs/msg/Twist", encoding="jsonschema")
            log.put(service, k / 10, b"\0\1\0\0\1")
            log.put(strange, k / 10, b"what")
    asked = declared(features={"observation.state": {**STATE, "topic": "joints"},
                               "action": {"topic": "/json", "fields": ["linear.x"]}})
    result, (episode,), _ = converted(log.path, asked)
    assert episode["observation.state"][:, 0].tolist() == episode["action"][:, 0].tolist() == list(range(10))
    uses = {t.topic: (t.use, t.messages) for t in result.topics}
    assert uses == {"joints": ("used", 11), "/json": ("used", 10), "/srv": ("undecodable", 10),
                    "/plc": ("undecodable", 10)}
    assert "joints: 1 messages have log time 0 (latched); not used" in result.problems


def test_a_log_without_any_arm_becomes_a_dataset_of_what_it_has(foreign_log, converted):
    with foreign_log() as log:
        for k in range(50):
            log.json("plc/tank", k / 10, {"level": 0.1 * k, "valve_open": k % 2 == 0})
    asked = declared(features={"observation.plc": {"topic": "plc/tank", "fields": ["level", "valve_open"]}})
    result, (episode,), _ = converted(log.path, asked)
    assert episode["observation.plc"][:3].tolist() == [pytest.approx(v) for v in ([0, 1], [0.1, 0], [0.2, 1])]
    assert result.features["observation.plc"] == ("level", "valve_open")


def test_an_episode_longer_than_a_piece_is_filled_as_one(foreign_log, converted, monkeypatch):
    with foreign_log() as log:
        joints(log, [*np.arange(0, 2.01, 0.1), *np.arange(2.5, 4, 0.1)])
    result, whole, _ = converted(log.path, declared())
    monkeypatch.setattr("pipeline.logs.filling.PIECE", 7)
    same, pieces, _ = converted(log.path, declared(), name="pieces")
    assert (same, [len(e["observation.state"]) for e in pieces]) == (result, [22, 15])
    for one, other in zip(whole, pieces, strict=True):
        assert all((one[name] == other[name]).all() for name in one)


@pytest.mark.parametrize(("fields", "line", "mend"), [
    ({"features": {"a": {**STATE, "topic": "/joint"}}}, "topic /joint, required by map 'theirs', is missing",
     "it holds: /joints"),
    ({"cameras": {"wrist": {"topic": "/cam"}}}, "topic /cam, required by map 'theirs', is missing", "/joints"),
    ({"features": {"a": {"topic": "/joints", "fields": ["positon"]}}}, "no number field 'positon' .10 messages.",
     "its number fields are: "),
    ({"features": {"a": {**STATE, "joints": ["hip"]}}}, "does not name joint 'hip'", "docs/ingest.md"),
    ({"features": {"a": {**STATE, "scale": [1, 2, 3]}}}, "a: scale has 3 entries for 2 values", "docs/ingest.md"),
    ({"features": {"a": {"topic": "/joints", "fields": ["position"], "names": ["x", "y"]}}},
     "a has 3 values, robot 'g1' expects 2", "docs/ingest.md"),
], ids=["topic", "camera", "field", "joint", "scale", "names"])
def test_a_map_that_does_not_fit_the_log_is_refused_in_one_line(foreign_log, converted, fields, line, mend):
    with foreign_log() as log:
        joints(log, np.arange(0, 1, 0.1))
    with pytest.raises(ConfigError, match=line) as error:
        converted(log.path, declared(**fields))
    assert mend in error.value.mend
    assert "\n" not in error.value.what


def test_progress_is_told_while_a_log_is_read(foreign_log, converted, monkeypatch):
    monkeypatch.setattr("pipeline.logs.convert.PROGRESS_S", 0)
    with foreign_log() as log:
        joints(log, np.arange(0, 100, 0.1))
    _, _, folder = converted(log.path, declared())
    assert log.path.stat().st_size / 2 < int((folder / "progress").read_text()) <= log.path.stat().st_size


def test_the_result_is_plain_json(foreign_log, converted):
    with foreign_log() as log:
        joints(log, np.arange(0, 1, 0.1))
    result, _, _ = converted(log.path, declared())
    assert Converted.model_validate(json.loads(json.dumps(result.model_dump(mode="json")))) == result
