"""A simulated robot, recorded live: the same frames as in a batch, and a file that Rerun shows by itself."""

import io

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image

from pipeline.errors import ConfigError, SimulationError
from pipeline.recording import read_attachments, read_episode, read_frames, write_episode
from pipeline.recording.filming import Filming
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.robots.simulated import SimulatedRobot
from pipeline.simulation.bodies import arm
from pipeline.simulation.expert import Expert
from pipeline.simulation.live_cameras import SceneCameras
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.rendering import backend
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import World
from schemas.episode import Episode, Outcome, Segment
from stages.record import record

SCENE = sample_scene("pick-place", "study", scene_seed("study", 3), "common")
LINKS = ("forearm", "wrist", "hand", "left_finger")


def make_world() -> World:
    return World(compose(arm(), "table"), [SCENE], from_draws([()]), threads=1)


def renders() -> bool:
    try:
        return bool(backend())
    except SimulationError:
        return False


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """One attempt of the expert, recorded as fast as it goes, with two cameras where they render."""
    path = tmp_path_factory.mktemp("live") / "a.mcap"
    robot = SimulatedRobot(make_world(), "arm", judged=True, speed=0)
    robot.begin(SCENE)
    start = beginning(id="00112233445566aa", origin="scripted", scene=SCENE, control_hz=20.0, generation=0,
                      kind="autonomous", actor="expert")
    files = {**robot.attachments(), "config.json": b"{}", "randomization.json": b"[]"}
    cameras = SceneCameras(robot.world.batch.get_model(0), ("front", "top"), width=160, height=120)
    with LiveRecorder(path, start, attachments=files) as recorder:
        filming = Filming(recorder, cameras) if renders() else None

        def show(tick: int, stamp_ns: int) -> None:
            if filming and tick % 10 == 0:
                cameras.show(robot.world.save(np.arange(1))[0][0], tick, stamp_ns)

        outcome = record(robot, Expert(), recorder, seconds=60, until_success=True, show=show)
        if filming:
            filming.stop()
        recorder.close(outcome)
    return path


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """The same attempt as a batch of one."""
    world, expert = make_world(), Expert()
    expert.reset(1)
    tracer = Tracer(world)
    rollout(world, expert, tracer=tracer)
    (trace,) = tracer.traces()
    episode = Episode(id="00112233445566aa", origin="scripted", scene=SCENE, control_hz=20.0, frames=len(trace),
                      outcome=Outcome(label="success", judged_by="simulator"), generation=0,
                      segments=(Segment(kind="autonomous", start=0, stop=len(trace), actor="expert"),))
    path = tmp_path_factory.mktemp("batch") / "a.mcap"
    write_episode(path, episode, trace, attachments={})
    return path


def test_live_and_batch_give_the_same_frames(live, batch):
    (episode, frames), (expected_episode, expected) = read_frames(live), read_frames(batch)
    assert len(frames) == len(expected) > 30
    for name, column in frames.columns().items():
        assert column.tobytes() == expected.columns()[name].tobytes(), name
    assert episode.model_copy(update={"blob": None}) == expected_episode.model_copy(update={"blob": None})


def test_live_and_batch_restore_the_same_states(live, batch):
    (_, trace), (_, expected) = read_episode(live), read_episode(batch)
    for name in ("sim_state", "controller", "link_poses", "joint_velocity", "joint_effort"):
        assert getattr(trace, name).tobytes() == getattr(expected, name).tobytes(), name


def test_it_carries_scene_config_urdf_and_randomization(live):
    files = read_attachments(live)
    assert {"scene.xml", "config.json", "robot.urdf", "randomization.json"} == set(files)
    assert b"<mujoco" in files["scene.xml"] and b'<joint name="joint3"' in files["robot.urdf"]


@pytest.fixture(scope="module")
def shown(live):
    """What Rerun's own loader makes of the file: entity -> its columns, all rows of all chunks."""
    from rerun.chunk import McapReader

    found: dict[str, dict[str, list]] = {}
    for chunk in McapReader(live).stream():
        batch = pa.RecordBatch.from_pydict(chunk.to_record_batch().to_pydict())
        columns = found.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            columns.setdefault(name.rsplit(":", 1)[-1], []).extend(batch.column(name).to_pylist())
    return found


def test_rerun_moves_every_link_of_the_arm(live, shown):
    """A link's shapes hang on the frame of its name, and /tf moves that frame."""
    _, trace = read_episode(live)
    moves = shown["/tf"]
    at: dict[str, list] = {}
    names = [name for name in moves["child_frame"] if name]
    for name, place in zip(names, [t for t in moves["translation"] if t], strict=True):
        at.setdefault(name[0], []).append(place[0])
    for link in LINKS:
        (shape, *_) = [e for e in shown if e.startswith(f"/arm/visual_geometries/{link}/")]
        assert [link] in shown[shape]["frame"]
        expected = trace.link_poses[:, trace.links.index(link), :3]
        np.testing.assert_allclose(np.array(at[link]), expected, atol=1e-6)
        assert np.ptp(expected, axis=0).max() > 0.05, "it moves"


def test_rerun_plots_joints_by_their_names(shown, live):
    _, trace = read_episode(live)
    plot = shown["/joint_states/position"]
    assert [*(f"joint{k}" for k in range(1, 7)), "gripper"] in plot["names"]
    values = np.array([row for row in plot["scalars"] if row])
    np.testing.assert_allclose(values, trace.state[:, :7], atol=1e-6)


@pytest.mark.skipif(not renders(), reason="nothing renders here")
def test_rerun_shows_what_the_cameras_saw(shown, live):
    for camera in ("front", "top"):
        blobs = [row for row in shown[f"/camera/{camera}/image/compressed"]["blob"] if row]
        first, last = (np.array(Image.open(io.BytesIO(bytes(row[0])))).astype(int) for row in (blobs[0], blobs[-1]))
        assert len(blobs) == -(-len(read_frames(live)[1]) // 10), "every state that they were shown"
        assert first.shape == (120, 160, 3)
        assert (np.abs(first - last).max(axis=2) > 60).sum() > 20, "the arm and the cube have moved"


def test_a_camera_that_the_scene_does_not_have(live):
    with pytest.raises(ConfigError, match=r"unknown camera 'side'\n.*\n  mend: use one of: front, top"):
        SceneCameras(make_world().setup.model, ("side",))
