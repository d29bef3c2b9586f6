"""The dialect against ROS 2's own definitions."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.recording.dialect import EPOCH_NS, TOPICS, definition, stamp_ns, topic_type

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


@pytest.mark.parametrize("ros_type", sorted({topic.type for topic in TOPICS.values()}))
def test_every_definition_is_that_of_ros_2(ros_type):
    ours = get_typestore(Stores.EMPTY)
    ours.register(get_types_from_msg(definition(ros_type), ros_type))
    assert ours.hash_rihs01(ros_type) == HUMBLE.hash_rihs01(ros_type)


@pytest.mark.parametrize(("topic", "ros_type"), [
    ("/reward/reach", "std_msgs/msg/Float64"),
    ("/policy/0123456789abcdef/disagreement", "std_msgs/msg/Float64"),
    ("/policy/0123456789abcdef/joint_commands", "sensor_msgs/msg/JointState"),
    ("/camera/wrist/image/compressed", "sensor_msgs/msg/CompressedImage"),
    ("/tf", "tf2_msgs/msg/TFMessage"),
])
def test_topics_of_a_family_have_its_type(topic, ros_type):
    assert topic_type(topic) == ros_type


@pytest.mark.parametrize("topic", ["/reward/", "/nothing", "joint_states"])
def test_a_topic_that_is_not_of_the_dialect_has_no_type(topic):
    with pytest.raises(KeyError):
        topic_type(topic)


def test_time_counts_from_the_fixed_epoch():
    assert [stamp_ns(tick, 20.0) - EPOCH_NS for tick in (0, 1, 200)] == [0, 50_000_000, 10_000_000_000]
