"""Recordings do not depend on which legged robot it is."""

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.locomotion.bodies import load_legged
from pipeline.locomotion.robots import LeggedRobots
from pipeline.locomotion.starts import as_data, draw_start
from pipeline.locomotion.tasks import load_legged_task
from pipeline.locomotion.tracing import LeggedTracer
from pipeline.recording import read_episode
from pipeline.simulation.recordings import record
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import SceneSpec

TICKS = 450
"""More than one chunk of a recording."""



class Swing:
    """Asks for more and more."""

    tick = 0

    def reset(self, n):
        pass

    def act(self, observation, ids):
        self.tick += 1
        return np.full((len(ids), 1), 0.002 * self.tick)

    def memory(self, ids):
        return np.zeros((len(ids), 0))


@pytest.fixture(scope="module")
def swung(tmp_path_factory, strider_urdf):
    """A robot of one joint under torque, from its URDF, for nine seconds: what was traced, and its recording."""
    folder = tmp_path_factory.mktemp("strider")
    (folder / "strider.urdf").write_text(strider_urdf)
    body, task = load_legged(str(folder / "strider.urdf")), load_legged_task("stand")
    ids, policy = np.arange(1), Swing()
    scene = SceneSpec(family="study", seed=1, robot="strider", scene="ground", task="stand", stratum="leaning",
                      object_xy_m=(0, 0), object_yaw_rad=0, object_half_m=0, target_xy_m=(0, 0),
                      legged=as_data(draw_start(task, body, "leaning", 1)))
    robots = LeggedRobots(body, task, [scene])
    tracer = LeggedTracer(robots)
    for _ in range(TICKS):
        seen = robots.observe(ids)
        action = policy.act(seen, ids)
        tracer.before(ids, seen, action, policy)
        robots.act(action, ids)
        tracer.after(ids)
    (trace,) = tracer.traces()
    episode = Episode(id="0" * 16, origin="deployed", scene=scene, control_hz=trace.hz, frames=TICKS, generation=0,
                      outcome=Outcome(label="success", judged_by="sensors"),
                      segments=(Segment(kind="autonomous", start=0, stop=TICKS, actor="c" * 16),))
    return trace, record(folder, robots.setup, [episode], [trace], config={}, software={})[0].path


def test_a_robot_under_torque_is_recorded_as_one(swung):
    trace, path = swung
    _, read = read_episode(path)
    assert (read.torque, read.joints) == (True, ("hip",))
    asked = np.arange(1, TICKS + 1) * 0.002
    assert np.allclose(read.action[:, 0], asked) and np.array_equal(read.joint_action, trace.joint_action)
    assert np.ptp(read.joint_action) > 0.1 and np.array_equal(read.sim_state, trace.sim_state)


def test_a_recording_that_was_cut_off_keeps_its_whole_ticks(swung, tmp_path):
    trace, path = swung
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:path.stat().st_size * 2 // 3])
    with pytest.raises(RecordingError, match="accept-truncated"):
        read_episode(cut)
    episode, read = read_episode(cut, accept_truncated=True)
    assert 0 < episode.frames < TICKS and np.array_equal(read.state, trace.state[:episode.frames])
