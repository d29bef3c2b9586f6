"""A robot is drawn where it was: the URDF's joints lead to the poses that the simulator recorded."""

import numpy as np
import pytest

from pipeline.browsing.urdf import poses, read_urdf
from pipeline.errors import RecordingError
from pipeline.frames import JOINTS
from pipeline.recording.read import open_recording


def test_measured_joints_lead_to_the_poses_that_were_recorded(shelf, store):
    opened = open_recording(store.blob(shelf.demonstrations[0].blob))
    trace, urdf = opened.decoder.trace(), read_urdf(opened.attachments["robot.urdf"], "test")
    values = {name: trace.state[:, k] for k, name in enumerate(JOINTS)}
    values |= {j.name: trace.state[:, 6] / 2 for j in urdf.joints if j.kind == "prismatic"}
    found = poses(urdf, values)
    for k, link in enumerate(trace.links):
        if link != "object":
            assert np.abs(found[link][:, :3] - trace.link_poses[:, k, :3]).max() < 2e-3, link
            same = np.abs((found[link][:, 3:] * trace.link_poses[:, k, 3:]).sum(axis=1))
            assert same.min() > 0.9999, link


def test_a_joint_turns_about_its_axis_in_its_own_frame():
    text = b"""<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
      <joint name="j" type="revolute"><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/><parent link="a"/>
        <child link="b"/><axis xyz="0 0 2"/></joint>
      <joint name="k" type="fixed"><origin xyz="1 0 0"/><parent link="b"/><child link="c"/></joint></robot>"""
    found = poses(read_urdf(text, "test"), {"j": np.array([0.0, np.pi / 2])})
    assert found["c"][:, :3] == pytest.approx(np.array([[1, 1, 0], [0, 0, 0]]), abs=1e-9)


@pytest.mark.parametrize("text", [b"<robot>", b'<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
                                  b'<robot><link name="a"/><joint name="j"/></robot>'],
                         ids=["cut off", "entities", "a joint of nothing"])
def test_what_is_no_urdf_is_refused_with_its_mend(text):
    with pytest.raises(RecordingError, match="mend: attach a URDF with named links and joints"):
        read_urdf(text, "test")
