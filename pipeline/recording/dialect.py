"""The MCAP dialect of a recording: topics, message definitions and the clock; ROS 2 CDR, as every viewer reads it."""

from types import MappingProxyType
from typing import NamedTuple

from pipeline.frames import STATE

PROFILE, MESSAGE_ENCODING, SCHEMA_ENCODING = "ros2", "cdr", "ros2msg"
LIBRARY = "hardcase"
SCHEMA_VERSION = "1"
EPOCH_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: tick 0 of every simulated episode, so that bytes never depend on the clock [ns]."""
JOINT_NAMES = STATE[:7]
"""Names in every JointState: six joints [rad], then the finger opening [m]."""
WORLD = "world"
"""Frame that every pose is given in."""


class Topic(NamedTuple):
    """What one topic carries; a part in <angle brackets> stands for a name of its own."""

    type: str
    meaning: str


_JOINTS, _ARRAY, _POSE = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/PoseStamped"
_FLOAT, _TEXT = "std_msgs/msg/Float64", "std_msgs/msg/String"

TOPICS: MappingProxyType[str, Topic] = MappingProxyType({
    "/robot_description": Topic(_TEXT, "URDF of the robot; first message, at the recording's start"),
    "/joint_states": Topic(_JOINTS, "measured position [rad or m], velocity, effort"),
    "/joint_commands": Topic(_JOINTS, "joint targets that were sent"),
    "/joint_commands/asked": Topic(_JOINTS, "what the policy asked for before the shield, when it differs"),
    "/command/ee": Topic(_ARRAY, "action: dx, dy, dz, dyaw [m, rad] from the last commanded pose, and opening [m]"),
    "/ee/measured": Topic(_ARRAY, "end-effector pose by forward kinematics of the measured joints: x, y, z, yaw"),
    "/ee/commanded": Topic(_ARRAY, "last commanded pose and opening: x, y, z, yaw, gripper"),
    "/observation/object": Topic(_POSE, "object as perceived, bias and noise included; for viewers"),
    "/observation/target": Topic(_POSE, "target as perceived; for viewers"),
    # A quaternion gives a yaw back only to the last bit or so: half angle, sine and arctangent each round, a turn
    # beyond one revolution is lost, and a value that lies between two float32 can fall to the other side. The
    # seven numbers therefore also travel as they are.
    "/observation/environment": Topic(_ARRAY, "object x, y, z, yaw and target x, y, z as perceived, exact"),
    "/tf": Topic("tf2_msgs/msg/TFMessage", "true poses in simulation, for the 3D view; frames are the URDF's links"),
    "/imu": Topic("sensor_msgs/msg/Imu", "where the body has one; without a heading of its own"),
    "/observation/state": Topic(_ARRAY, "legged robots: what the policy is given, exact"),
    "/command/joints": Topic(_ARRAY, "legged robots: action, shares of each joint's reach in [-1, 1]"),
    "/wrench": Topic("geometry_msgs/msg/WrenchStamped", "where the body has a force sensor"),
    "/touch/<name>": Topic(_FLOAT, "contact force [N]"),
    "/camera/<name>/image/compressed": Topic("sensor_msgs/msg/CompressedImage", "JPEG"),
    "/task/phase": Topic(_TEXT, "subtask, written when it changes"),
    "/teleop/joy": Topic("sensor_msgs/msg/Joy", "raw operator input"),
    "/sim/state": Topic(_ARRAY, "mjSTATE_INTEGRATION before the action of the tick; never reaches a dataset"),
    "/sim/controller": Topic(_ARRAY, "the rest of what a restore needs; never reaches a dataset"),
    "/reward/<term>": Topic(_FLOAT, "one topic a term"),
    "/policy/<id>/joint_commands": Topic(_JOINTS, "what a shadow policy would have sent"),
    "/policy/<id>/disagreement": Topic(_FLOAT, "distance of the shadow's action to the champion's"),
    "/signal/<name>": Topic(_FLOAT, "a sign of risk: distance, revision, apart, spread, flips, warning"),
    "/events": Topic("rcl_interfaces/msg/Log", "triggers, interventions, limits hit"),
})
"""Every topic of the dialect, from the design's table; a body without the sensor leaves its topic out."""

FRAME_TOPICS = ("/joint_states", "/ee/measured", "/ee/commanded", "/observation/environment", "/command/ee",
                "/joint_commands")
"""Topics that a dataset's features are rebuilt from."""
LEGGED_TOPICS = ("/joint_states", "/imu", "/observation/state", "/command/joints", "/joint_commands")
"""Topics without which a recording of a legged robot is of no use."""
RESTORE_TOPICS = ("/sim/state", "/sim/controller")
"""Topics that a frame is restored from."""


def every_tick(topic: str) -> bool:
    """Whether a trace is rebuilt from this topic, one message a tick."""
    return topic in _EVERY_TICK or topic.startswith(("/reward/", "/policy/", "/signal/"))


_EVERY_TICK = frozenset({*FRAME_TOPICS, *LEGGED_TOPICS, *RESTORE_TOPICS, "/tf"})
_HEADER = "std_msgs/Header header\n"
_DEFINITIONS = MappingProxyType({
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Float64": "float64 data\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data\n",
    "std_msgs/msg/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n",
    "std_msgs/msg/MultiArrayDimension": "string label\nuint32 size\nuint32 stride\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "sensor_msgs/msg/JointState": _HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "sensor_msgs/msg/CompressedImage": _HEADER + "string format\nuint8[] data\n",
    "sensor_msgs/msg/Joy": _HEADER + "float32[] axes\nint32[] buttons\n",
    "sensor_msgs/msg/Imu": _HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/msg/PoseStamped": _HEADER + "geometry_msgs/Pose pose\n",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/msg/TransformStamped": _HEADER + "string child_frame_id\ngeometry_msgs/Transform transform\n",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/msg/WrenchStamped": _HEADER + "geometry_msgs/Wrench wrench\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "rcl_interfaces/msg/Log": "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
    "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
})
"""ROS 2 type -> its own fields; Source: ros2/common_interfaces, ros2/rcl_interfaces and ros2/geometry2, Humble."""


def topic_type(topic: str) -> str:
    """ROS 2 type of a topic; topics of a family are matched by their fixed parts."""
    if topic in TOPICS:
        return TOPICS[topic].type
    for pattern, entry in TOPICS.items():
        before, bracket, rest = pattern.partition("<")
        after = rest.partition(">")[2]
        fits = topic.startswith(before) and topic.endswith(after) and len(topic) > len(before) + len(after)
        if bracket and fits:
            return entry.type
    raise KeyError(topic)


def definition(ros_type: str) -> str:
    """The ros2msg text of a type: its own fields, then every nested type once, each under its MSG line."""
    parts, seen, queue = [_DEFINITIONS[ros_type]], {ros_type}, [ros_type]
    while queue:
        for line in _DEFINITIONS[queue.pop(0)].splitlines():
            name = line.split()[0].split("[")[0]
            nested = name.replace("/", "/msg/")
            if "/" in name and nested not in seen:
                seen.add(nested)
                queue.append(nested)
                parts.append(f"MSG: {name}\n{_DEFINITIONS[nested]}")
    return f"{'=' * 80}\n".join(parts)


def stamps_ns(ticks: int, hz: float) -> list[int]:
    """Log time of ticks 0..ticks-1 at `hz`, counted from EPOCH_NS [ns]."""
    return [stamp_ns(tick, hz) for tick in range(ticks)]


def stamp_ns(tick: int, hz: float) -> int:
    """Log time of one tick at `hz` [ns]."""
    return EPOCH_NS + round(tick * 1e9 / hz)
