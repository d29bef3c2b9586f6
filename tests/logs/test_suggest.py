"""First maps for logs of all kinds: what is guessed, what is said, and that every map loads and can be used."""

import math
from pathlib import Path

import pytest
import yaml
from google.protobuf import descriptor_pb2, timestamp_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import RecordingError
from pipeline.logs.convert import convert
from pipeline.logs.mapping import load_map
from pipeline.logs.suggest import first_map, suggest
from pipeline.logs.survey import Survey, survey

LOGS = Path(__file__).parents[3] / "shared/logs"
START_NS = 1_760_000_000 * 10**9
"""When the logs of the fixture begin."""
NAMES = ["shoulder", "elbow", "wrist"]


def header(at, behind=0.003):
    ns = START_NS + round((at - behind) * 1e9)
    return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}


def joints(at, k, names=NAMES, scale=1.0):
    return {"header": header(at), "name": names, "position": [scale * math.sin(k / 20)] * len(names),
            "velocity": [0.0] * len(names), "effort": []}


def loaded(text, tmp_path):
    file = tmp_path / "map.yaml"
    file.write_text(text, encoding="utf-8")
    return load_map(file)


def test_an_arm_with_cameras_is_understood_and_its_map_converts_the_log(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(200):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 100, joints(k / 100, k))
            if k % 2 == 0:
                made.ros("/arm_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", k / 100,
                         {"header": header(k / 100), "joint_names": NAMES,
                          "points": [{"positions": [0.1, 0.2, 0.3], "time_from_start": {"sec": 0, "nanosec": 5}}]})
            if k % 4 == 0:
                made.ros("/camera/wrist/image_raw/compressed", "sensor_msgs/msg/CompressedImage", k / 100,
                         {"header": header(k / 100), "format": "jpeg", "data": b"\xff\xd8\xff" + bytes(5000)})
    text = suggest(made.path)
    found = loaded(text, tmp_path)
    [state], [action] = found.features["observation.state"], found.features["action"]
    assert (state.topic, state.fields, state.joints) == ("/joint_states", ("position",), tuple(NAMES))
    assert (action.topic, action.fields) == ("/arm_controller/joint_trajectory", ("points.positions",))
    assert (action.joints, action.joints_field) == (tuple(NAMES), "joint_names")
    assert found.cameras["wrist"].topic == "/camera/wrist/image_raw/compressed"
    assert (found.name, found.fps, found.clock, found.episodes.by) == ("their_log_01", 25, "header", "file")
    assert "100 Hz (jitter 0" in text
    assert "velocity (3 values)" in text
    (tmp_path / "out").mkdir()
    made_of_it = convert(str(made.path), found.model_dump_json(), str(tmp_path / "out"))
    assert sum(span["frames"] for span in made_of_it["spans"]) >= 45


def test_of_trajectories_with_several_points_the_first_is_taken(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(30):
            points = [{"positions": [0.1 * n, 0.2, 0.3], "time_from_start": {"sec": n, "nanosec": 0}}
                      for n in range(1 + k % 3)]
            made.ros("/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", k / 50,
                     {"header": header(k / 50), "joint_names": NAMES, "points": points})
    [action] = loaded(suggest(made.path), tmp_path).features["action"]
    assert (action.fields, action.names) == (("points.positions[0:3]",), tuple(NAMES))


def test_latched_messages_at_time_0_do_not_touch_the_rate(foreign_log, tmp_path):
    with foreign_log() as made:
        made.ros("robot_description", "std_msgs/msg/String", None, {"data": "<robot/>"})
        made.ros("joint_states", "sensor_msgs/JointState", None, joints(0, 0))
        for k in range(100):
            made.ros("joint_states", "sensor_msgs/JointState", k / 50, joints(k / 50, k))
            made.ros("cmd_vel", "geometry_msgs/Twist", k / 50, {"linear": {"x": 0.1, "y": 0.0, "z": 0.0},
                                                              "angular": {"x": 0.0, "y": 0.0, "z": 0.2}})
    text = suggest(made.path)
    found = loaded(text, tmp_path)
    assert found.fps == 50
    assert found.features["observation.state"][0].topic == "joint_states"
    assert found.features["action"][0].fields == tuple(f"{a}.{b}" for a in ("linear", "angular") for b in "xyz")
    assert "1 latched at time 0" in text
    assert found.features["action"][0].clock == "log"
    assert found.clock == "header"


def test_stamps_that_are_not_set_make_log_time_the_clock(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(50):
            message = joints(k / 50, k) | {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}}
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, message)
    text = suggest(made.path)
    assert loaded(text, tmp_path).clock == "log"
    assert "stamps of /joint_states are not set" in text


def test_what_is_left_over_can_be_had_by_taking_the_comment_signs_away(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(60):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k))
            for topic in ("/force", "/observation/force", "/base/command", "/gripper/command"):
                made.ros(topic, "std_msgs/msg/Float64MultiArray", k / 50,
                         {"layout": {"dim": [], "data_offset": 0}, "data": [1.0, 2.0]})
    before, _, after = suggest(made.path).partition("  # action.")
    rest = "".join(f"  {line[4:]}\n" if line.startswith("  # ") else f"{line}\n" for line in after.split("\n"))
    found = loaded(before + "  action." + rest, tmp_path)
    assert set(found.features) == {"observation.state", "action", "action.gripper", "observation.force",
                                   "observation.force_4"}
    assert len({source.topic for many in found.features.values() for source in many}) == 5


def test_degrees_are_noticed(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(90):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k, scale=120))
    assert "unit: deg_to_rad" in suggest(made.path)


def test_a_topic_of_two_nodes_takes_the_commonest_names(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(60):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k))
            if k % 3 == 0:
                made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k, names=["finger"]))
    text = suggest(made.path)
    assert loaded(text, tmp_path).features["observation.state"][0].joints == tuple(NAMES)
    assert "2 sets of names share the topic" in text


def test_sensors_without_an_arm_stand_side_by_side(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(40):
            made.json("plc/pressure", k / 10, {"value": 3.0 + k, "unit": "bar", "timestamp": k})
            made.json("plc/valves", k / 10, {"open": [True, False], "id": 7})
            made.json("/setpoints", k / 5, {"p": 3.5})
    text = suggest(made.path)
    found = loaded(text, tmp_path)
    state = {source.topic: source.fields for source in found.features["observation.state"]}
    assert state == {"plc/pressure": ("value",), "plc/valves": ("open",)}
    assert found.features["action"][0].topic == "/setpoints"
    assert "No topic looks like an arm's joints" in text
    assert "no cameras" in text


@pytest.mark.parametrize(("values", "start", "stop"), [
    (["start", "stop"], ("start",), ("stop",)),
    (["episode_begin", "episode_end"], ("episode_begin",), ("episode_end",)),
], ids=["plain", "longer"])
def test_a_topic_that_marks_episodes_is_used(values, start, stop, foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(200):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k))
            if k % 50 == 10:
                made.ros("/episode", "std_msgs/msg/String", k / 50, {"data": values[k // 50 % 2]})
    found = loaded(suggest(made.path), tmp_path)
    assert (found.episodes.by, found.episodes.topic) == ("marker", "/episode")
    assert (found.episodes.start, found.episodes.stop) == (start, stop)


def test_silence_parts_episodes_where_nothing_marks_them(foreign_log, tmp_path):
    with foreign_log() as made:
        for k in range(300):
            at = k / 50 + 7 * (k // 100)
            made.ros("/joint_states", "sensor_msgs/msg/JointState", at, joints(at, k))
    text = suggest(made.path)
    found = loaded(text, tmp_path)
    assert (found.episodes.by, found.episodes.topic) == ("gap", "/joint_states")
    assert 1 < found.episodes.longer_than_s < 7.02
    assert "7.02 s, 7.02 s" in text


def test_what_cannot_be_decoded_is_named_and_the_rest_suggested(foreign_log, tmp_path):
    with foreign_log() as made:
        service = made.channel("/add/_service_event", "example_interfaces/srv/AddTwoInts_Event", "ros2msg",
                               b"int64 a\n---\nint64 sum", "cdr")
        strange = made.channel("/lidar", "points", "flatbuffer", b"\x01\x02", "flatbuffer")
        for k in range(20):
            made.put(service, k / 10, b"\x00\x01\x00\x00")
            made.put(strange, k / 10, b"xyz")
            made.json("/joint_states", k / 10, {"name": NAMES, "position": [0, 1, k]}, "JointState", "ros2msg")
    text = suggest(made.path)
    found = loaded(text, tmp_path)
    assert found.features["observation.state"][0].joints == tuple(NAMES)
    assert "#   /add/_service_event, example_interfaces/srv/AddTwoInts_Event, cdr: 20 messages" in text
    assert "cannot be decoded: example_interfaces/AddTwoInts_Event is a service definition" in text
    assert "encoded as flatbuffer with schema flatbuffer" in text


def test_protobuf_and_a_foxglove_camera_are_suggested(foreign_log, tmp_path):
    files = descriptor_pb2.FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(files.file.add())
    file = files.file.add(name="f.proto", package="foxglove", dependency=["google/protobuf/timestamp.proto"])
    image, arm = file.message_type.add(name="CompressedImage"), file.message_type.add(name="Arm")
    for message in (image, arm):
        message.field.add(name="timestamp", number=1, label=1, type=11, type_name=".google.protobuf.Timestamp")
    image.field.add(name="data", number=2, label=1, type=12)
    arm.field.add(name="q", number=2, label=3, type=1)
    pool = DescriptorPool()
    for one in files.file:
        pool.Add(one)
    sent = (("/top_cam", "CompressedImage", lambda k: {"data": b"\x89PNG" + bytes(900)}),
            ("/follower/arm", "Arm", lambda k: {"q": [k, 2.0]}), ("/leader/arm", "Arm", lambda k: {"q": [k, 1.0]}))
    with foreign_log() as made:
        for k in range(60):
            for topic, name, content in sent:
                message = GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))(**content(k))
                message.timestamp.FromNanoseconds(START_NS + k * 33_366_700)
                channel = made.channel(topic, f"foxglove.{name}", "protobuf", files.SerializeToString(), "protobuf")
                made.put(channel, k / 29.97, message.SerializeToString())
    found = loaded(suggest(made.path), tmp_path)
    assert found.cameras["top"].topic == "/top_cam"
    assert found.features["observation.state"][0].topic == "/follower/arm"
    assert found.features["action"][0].topic == "/leader/arm"
    assert (found.fps, found.clock) == (30, "header")


def test_a_log_without_numbers_is_refused_with_what_it_holds(foreign_log):
    with foreign_log() as made:
        made.ros("/chatter", "std_msgs/msg/String", 0, {"data": "hello"})
    with pytest.raises(RecordingError, match=r"(?s)no topic has a number.*at: .*mend: record what .*holds: /chatter"):
        suggest(made.path)


def test_the_command_writes_a_map_to_a_new_file_only(foreign_log, tmp_path, hardcase):
    with foreign_log() as made:
        for k in range(20):
            made.ros("/joint_states", "sensor_msgs/msg/JointState", k / 50, joints(k / 50, k))

    def call(*arguments):
        return hardcase("ingest", "--suggest", *arguments)

    file = tmp_path / "theirs.yaml"
    code, said, _ = call(made.path, "--out", file)
    assert code == 0
    assert f"--map {file}" in said
    assert load_map(file).features["observation.state"][0].joints == tuple(NAMES)
    file.write_text("edited")
    code, _, told = call(made.path, "--out", file)
    assert (code, file.read_text()) == (2, "edited")
    assert "mend: name another --out" in told
    code, _, told = call(made.path, made.path)
    assert code == 2
    assert "mend: name one recording" in told


@settings(max_examples=30, deadline=None)
@given(topic=st.text(min_size=1, max_size=30), joint=st.text(max_size=10), name=st.text(max_size=20),
       word=st.sampled_from(["start", "yes", "start: #"]))
def test_whatever_things_are_called_the_map_loads_and_means_them(topic, joint, name, word):
    numbers = {"widths": [2], "low": 0, "high": 1, "integral": False}
    plain = {"type": name, "encoding": "cdr", "messages": 5, "bytes": 5, "latched": 0, "first_ns": 1, "last_ns": 2,
             "rate_hz": 50, "jitter_s": 0, "pauses": [], "reason": name, "bad": 1, "bad_reason": name, "times": [],
             "stamps": None, "numbers": {}, "texts": {}, "names": {}, "named": {}, "blobs": {}}
    seen = Survey.model_validate({"problems": [name], "topics": [
        plain | {"topic": topic, "numbers": {"position": numbers, name: numbers}, "names": {"name": [joint, "other"]},
                 "named": {"name": 1}},
        plain | {"topic": f"episode {topic}", "texts": {"data": [word, "stop"]}},
        plain | {"topic": f"camera {topic}", "blobs": {"data": "jpeg", name: ""}}]})
    found = yaml.safe_load(first_map(name, seen))
    source = next(iter(found["features"].values()))[0]
    assert source["topic"] == topic
    assert source.get("joints", [joint])[0] == joint
    [camera] = found["cameras"].values()
    assert camera["topic"] == f"camera {topic}"


@pytest.mark.skipif(not LOGS.exists(), reason="recordings of others are not part of the project")
@pytest.mark.parametrize(("file", "topic"), [
    ("rosbag2_cdr_test", "/array_topic"), ("rosbag2_talker", "/rosout"),
    ("rosbag2parquet_array_msgs", "/one_shot/joint_state"),
])
def test_recordings_of_others_get_a_map(file, topic, tmp_path):
    text = suggest(LOGS / f"{file}.mcap")
    assert loaded(text, tmp_path).features["observation.state"][0].topic == topic
    assert Survey.model_validate(survey(str(LOGS / f"{file}.mcap"))).topics
