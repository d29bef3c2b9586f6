"""Cameras that film while the robot moves: every state that was shown, none silently left out, broken ones told."""

import time

import numpy as np
import pytest

from pipeline.errors import RobotError, SimulationError
from pipeline.protocols import Picture
from pipeline.recording import read_episode
from pipeline.recording.filming import Filming
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row
from pipeline.simulation.live_cameras import BACKLOG, SceneCameras
from pipeline.simulation.rendering import FilmCamera, backend


@pytest.fixture
def recorder(tmp_path, starts):
    episode = beginning(id="00112233445566aa", origin="scripted", scene=starts(1)[0], control_hz=20.0, generation=0,
                        actor="expert")
    with LiveRecorder(tmp_path / "a.mcap", episode, attachments={}) as recorder:
        yield recorder


@pytest.fixture
def renders():
    try:
        backend()
    except SimulationError as error:
        pytest.skip(error.what)


def finish(recorder) -> list:
    """Close with one tick, and give the events back."""
    recorder.tick(0, Row(np.zeros(16), np.zeros(7), np.zeros(5), np.zeros(7)))
    closed = recorder.close()
    return [(event.level, event.text) for event in read_episode(closed.path)[1].events]


def test_each_camera_shows_each_state_as_a_film_of_it_would(renders, make_world, starts):
    world = make_world(starts(1))
    states = []
    for _ in range(3):
        world.act(np.array([[0.02, 0.01, -0.02, 0.0, 0.0]]), np.arange(1))
        states.append(world.save(np.arange(1))[0][0])
    cameras = SceneCameras(world.setup.model, ("top", "front"), width=64, height=48)
    cameras.open()
    for tick, state in enumerate(states):
        cameras.show(state, tick, 1000 + tick)
    found = [picture for _ in states for picture in cameras.read(0.1)]
    assert cameras.read(0.01) == []
    cameras.close()
    assert [(p.camera, p.tick, p.stamp_ns) for p in found] == [
        (name, tick, 1000 + tick) for tick in range(3) for name in ("top", "front")]
    with FilmCamera(world.setup.model, camera="front", width=64, height=48) as film:
        expected = film.frames(np.array(states))
    assert all((p.pixels == e).all() for p, e in zip(found[1::2], expected, strict=True))


def test_states_that_nobody_could_film_are_told(renders, make_world, starts, recorder):
    world = make_world(starts(1))
    cameras, state = SceneCameras(world.setup.model, ("top",), width=64, height=48), world.save(np.arange(1))[0][0]
    for tick in range(BACKLOG + 7):
        cameras.show(state, tick, tick)
    with Filming(recorder, cameras) as filming:
        pass
    assert filming.taken == {"top": BACKLOG}
    assert finish(recorder) == [(30, "7 moments not taken: the cameras are slower than the robot")]


class Unplugged:
    """A camera that gives one picture and is gone then."""

    skipped = 0

    def __init__(self) -> None:
        self.left, self.closed = 1, False

    def open(self) -> None:
        pass

    def read(self, timeout_s: float) -> list[Picture]:
        if not self.left:
            raise RobotError("camera wrist gives no picture", where="/dev/video2", mend="plug it in again")
        self.left -= 1
        return [Picture("wrist", np.zeros((8, 8, 3), np.uint8))]

    def close(self) -> None:
        self.closed = True


def test_a_camera_that_is_unplugged_ends_the_filming_and_not_the_recording(recorder):
    camera = Unplugged()
    filming = Filming(recorder, camera)
    until = time.monotonic() + 240
    while filming.error is None and time.monotonic() < until:
        time.sleep(0.01)
    filming.stop()
    assert filming.error.mend == "plug it in again" and camera.closed
    assert finish(recorder) == [(40, "camera wrist gives no picture")]


def test_a_camera_that_does_not_open_says_so_at_once(recorder):
    class Missing(Unplugged):
        def open(self) -> None:
            raise RobotError("no camera wrist", where="/dev/video2", mend="plug it in")

    with pytest.raises(RobotError, match="no camera wrist"):
        Filming(recorder, Missing())
    assert recorder.tick(0, Row(np.zeros(16), np.zeros(7), np.zeros(5), np.zeros(7))), "the recording goes on"
