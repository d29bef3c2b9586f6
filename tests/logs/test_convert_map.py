"""A map that breaks a rule is refused with the field, the value and the rule, and the mend."""

import pytest

from pipeline.errors import ConfigError
from pipeline.logs.mapping import load_map

GOOD = """
name: theirs
robot: g1
task: walk to the door
fps: 30
features:
  observation.state: {topic: /joint_states, fields: [position], joints: [hip, knee]}
  action:
    - {topic: /cmd, fields: ["data[0:2]"], resample: linear, wrap: true, max_skew_s: 0.05, unit: deg_to_rad}
    - {topic: gripper, fields: [width], scale: -1}
cameras:
  head: {topic: /cam}
episodes: {by: gap, longer_than_s: 2}
outcome: {topic: /result, success: [ok], failure: [dropped]}
"""


def test_a_whole_map_is_read_and_a_single_source_needs_no_list(tmp_path):
    (tmp_path / "map.yaml").write_text(GOOD)
    declared = load_map(tmp_path / "map.yaml")
    assert [len(sources) for sources in declared.features.values()] == [1, 2]
    assert (declared.clock, declared.missing, declared.features["action"][0].resample) == ("log", "cut", "linear")


@pytest.mark.parametrize(("old", "new", "line", "mend"), [
    ("fps: 30", "fps: -30", "fps = -30: input should be greater than 0", "docs/ingest.md"),
    ("fps: 30", "fsp: 30", r"unknown key 'fsp' .and 1 more.", "use one of: cameras, clock, consent"),
    ("fps: 30", "", "'fps' is missing", "docs/ingest.md"),
    ("joints: [hip, knee]", "joint: [hip]", "unknown key 'features.observation.state.0.joint'", "joints, joints_field"),
    ("longer_than_s: 2", "longer_than: 2", r"unknown key 'episodes.gap.longer_than'", "by, longer_than_s, topic"),
    ("by: gap", "by: pause", "does not match any of the expected tags: 'file', 'marker', 'gap'", "docs/ingest.md"),
    ("failure: [dropped]", "fail: [dropped]", "unknown key 'outcome.from_topic.fail'", "clock, failure, field"),
    ("max_skew_s: 0.05", "max_skew_s: 0", r"max_skew_s = 0: input should be greater than 0", "docs/ingest.md"),
    ("scale: -1", "scale: .nan", "scale.*finite number", "docs/ingest.md"),
    ("resample: linear", "resample: cubic", "should be 'hold', 'nearest' or 'linear'", "docs/ingest.md"),
    ("resample: linear", "resample: hold", "only linear interpolation wraps angles", "docs/ingest.md"),
    ("data[0:2]", "data[2:2]", r"'data\[2:2\]' takes no element", "docs/ingest.md"),
    ("joints: [hip, knee]", "joints: [hip, hip]", "joints has 'hip' twice", "docs/ingest.md"),
    ("  action:", "  frame_index:", "a feature cannot be called 'frame_index': the name is taken", "docs/ingest.md"),
    ("longer_than_s: 2", "longer_than_s: 2, topic: /x", "use the topic of a feature: /cmd, /joint_states, gripper", ""),
    ("robot: g1", "robot: G1 left", r"robot = 'G1 left': string should match pattern", "docs/ingest.md"),
    ("robot: g1", "robot: g1\nconsent: form-1", "consent 'form-1' without operator", "docs/ingest.md"),
    ("robot: g1", "robot: [", "not YAML", "docs/ingest.md"),
])
def test_a_broken_map_is_refused_in_one_line(tmp_path, old, new, line, mend):
    (tmp_path / "map.yaml").write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError, match=line) as error:
        load_map(tmp_path / "map.yaml")
    assert mend in error.value.mend
    assert "\n" not in error.value.what
    assert str(tmp_path / "map.yaml") in error.value.where


@pytest.mark.parametrize(("content", "line"), [
    (b"- 1\n- 2\n", "an ingest map is a mapping, this is list"), (b"\xff\xfe\0", "not a text file of YAML"),
    (None, "cannot be read: No such file or directory"),
], ids=["a list", "no text", "not there"])
def test_what_is_no_map_is_refused(tmp_path, content, line):
    file = tmp_path / "map.yaml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=line) as error:
        load_map(file)
    assert "hardcase ingest --suggest LOG" in error.value.mend
