"""Filming a recording afterwards: the same recording, with what the cameras would have seen."""

import json

import numpy as np
import pytest
import simplejpeg
from rosbags.highlevel import AnyReader

from flows.teleop.film import film
from pipeline.errors import ConfigError, RecordingError, SimulationError
from pipeline.recording import read_attachments, read_episode, write_episode
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row
from pipeline.simulation.expert import Expert
from pipeline.simulation.recordings import record
from pipeline.simulation.refilm import SceneFilm
from pipeline.simulation.rendering import FilmCamera, backend
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tracing import Tracer
from schemas.episode import Episode, Outcome, Segment

SIZE = (96, 72)


@pytest.fixture(scope="module", autouse=True)
def renders():
    try:
        backend()
    except SimulationError as error:
        pytest.skip(error.what)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, setup, make_world, starts):
    """An attempt at the large cube, written as a batch writes it."""
    scene = starts(1, "large")[0]
    world, expert = make_world([scene]), Expert()
    expert.reset(1)
    tracer = Tracer(world)
    rollout(world, expert, tracer=tracer, horizon=30)
    (trace,) = tracer.traces()
    episode = Episode(id="00112233445566aa", origin="scripted", scene=scene, control_hz=20.0, frames=len(trace),
                      outcome=Outcome(label="failure", judged_by="simulator"), generation=0,
                      segments=(Segment(kind="demonstration", start=0, stop=len(trace), actor="expert"),))
    folder = tmp_path_factory.mktemp("recorded")
    (done,) = record(folder, setup, [episode], [trace], config={}, software={"software_commit": "abc"})
    return done.path


@pytest.fixture(scope="module")
def filmed(recorded):
    target = recorded.with_name("filmed.mcap")
    said = film(recorded, target, ("front", "top"), SIZE)
    assert f"{target}: {2 * len(read_episode(recorded)[1])} pictures of front, top" in said
    return target


def pictures(path, camera: str) -> dict[int, np.ndarray]:
    with AnyReader([path]) as reader:
        return {k: simplejpeg.decode_jpeg(bytes(reader.deserialize(raw, c.msgtype).data)) for k, (c, _, raw) in
                enumerate(m for m in reader.messages() if m[0].topic == f"/camera/{camera}/image/compressed")}


def test_the_rest_is_as_it_was(recorded, filmed):
    (episode, trace), (again, back) = read_episode(recorded), read_episode(filmed)
    assert again.model_copy(update={"blob": None}) == episode.model_copy(update={"blob": None})
    assert again.blob != episode.blob
    for name in ("state", "action", "sim_state", "controller", "link_poses"):
        assert getattr(back, name).tobytes() == getattr(trace, name).tobytes()
    assert (back.phase, back.events) == (trace.phase, trace.events)
    assert read_attachments(filmed) == read_attachments(recorded)


def test_every_tick_is_shown_with_the_cube_as_large_as_it_was(recorded, filmed, setup):
    episode, trace = read_episode(recorded)
    model = setup.model.__copy__()
    model.geom_size[model.geom("object").id] = episode.scene.object_half_m
    with FilmCamera(model, camera="front", width=SIZE[0], height=SIZE[1]) as camera:
        expected = camera.frames(trace.sim_state).astype(int)
    found = pictures(filmed, "front")
    assert len(found) == len(trace) == len(pictures(filmed, "top"))
    assert max(np.abs(found[k] - expected[k]).mean() for k in range(len(trace))) < 4, "as like as JPEG allows"


def test_what_cannot_be_filmed(recorded, filmed, tmp_path):
    with pytest.raises(RecordingError, match=r"pictures of camera 'front' already\n.*\n  mend: name another camera"):
        film(filmed, tmp_path / "a.mcap", ("front",), SIZE)
    with pytest.raises(RecordingError, match=r"already there\n.*\n  mend: name another file"):
        film(recorded, filmed, ("front",), SIZE)
    with pytest.raises(ConfigError, match=r"unknown camera 'side'\n.*\n  mend: use one of: front, top"):
        film(recorded, tmp_path / "a.mcap", ("side",), SIZE)
    with pytest.raises(ConfigError, match=r"no camera to film through\n.*\n  mend: --camera front"):
        film(recorded, tmp_path / "a.mcap", (), SIZE)
    assert list(tmp_path.iterdir()) == []


def test_a_recording_without_its_scene(recorded, tmp_path):
    episode, trace = read_episode(recorded)
    write_episode(tmp_path / "bare.mcap", episode, trace, attachments={"config.json": json.dumps({}).encode()})
    with pytest.raises(RecordingError, match=r"no scene.xml in the recording\n.*\n  mend: record it with its scene"):
        film(tmp_path / "bare.mcap", tmp_path / "a.mcap", ("front",), SIZE)


def test_a_real_robot_cannot_be_shown_again(recorded, tmp_path):
    episode, trace = read_episode(recorded)
    start = beginning(id=episode.id, origin="scripted", scene=episode.scene, control_hz=20.0, generation=0, actor="p7")
    with LiveRecorder(tmp_path / "real.mcap", start, attachments=read_attachments(recorded)) as recorder:
        for tick in range(5):
            recorder.tick(tick, Row(trace.state[tick], trace.environment[tick], trace.action[tick],
                                    trace.joint_action[tick]))
        recorder.close()
    with pytest.raises(RecordingError, match=r"no /sim/state: .*\n.*\n  mend: film while recording"):
        film(tmp_path / "real.mcap", tmp_path / "a.mcap", ("front",), SIZE)


@pytest.mark.parametrize(("xml", "message"), [
    (b'<mujoco><include file="/etc/passwd"/></mujoco>', "asks for other files or plugins"),
    (b"<mujoco><worldbody>", "does not compile"),
    (b"\xff\xfe", "does not compile"),
], ids=["include", "half", "no text"])
def test_a_scene_that_is_not_one(xml, message):
    with pytest.raises(SimulationError, match=rf"{message}.*\n  at:   scene.xml\n  mend: "):
        SceneFilm(xml, 0.02, ("front",), width=96, height=72)
