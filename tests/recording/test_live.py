"""Recording while it happens: the same data as the batch writer, everything else beside it, and clear refusals."""

import time

import numpy as np
import pytest
import simplejpeg
from mcap.reader import make_reader
from mcap.records import Attachment, Chunk, Metadata
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from pipeline.errors import RecordingError
from pipeline.recording import cdr, read_attachments, read_episode, read_frames, recover
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import joint_layout
from schemas.episode import Outcome, Segment

SUCCESS = Outcome(label="success", judged_by="operator")


@pytest.fixture
def picture():
    y, x = np.mgrid[0:120, 0:160]
    return np.stack([x, 2 * y, (x + y) // 2], axis=-1).astype(np.uint8)


@pytest.fixture
def lived(tmp_path, trace, start, row, attachments, picture):
    """60 ticks of an arm with a camera, taken over at tick 30."""
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments=attachments) as recorder:
        for tick in range(60):
            if tick in (0, 30):
                recorder.phase(trace().phase[tick], tick=tick)
            if tick == 30:
                recorder.segment("intervention", "operator-1", tick=tick)
            recorder.joy([0.5, -1.0], [1, 0, 1], tick=tick)
            recorder.image("front", picture, tick=tick)
            recorder.tick(tick, row(trace(), tick))
        return recorder.close(SUCCESS)


def test_it_holds_what_the_batch_writer_would_have_written(lived, trace):
    episode, back = read_episode(lived.path)
    for name in ("state", "environment", "action", "joint_action", "joint_velocity", "joint_effort", "link_poses",
                 "sim_state", "controller"):
        assert getattr(back, name).tobytes() == getattr(trace(), name).tobytes(), name
    assert (back.links, back.phase) == (trace().links, trace().phase)
    assert {n: v.tobytes() for n, v in back.reward.items()} == {n: v.tobytes() for n, v in trace().reward.items()}
    (shadow,), (expected,) = back.shadows.values(), trace().shadows.values()
    assert (shadow.joint_commands == expected.joint_commands).all()
    assert (shadow.disagreement == expected.disagreement).all()
    frames = read_frames(lived.path)[1]
    assert all((found == wanted).all() for found, wanted in
               zip(frames.columns().values(), trace().frames().columns().values(), strict=True))
    assert episode == lived.episode


def test_the_episode_says_how_it_went(lived, attachments):
    episode, _ = read_episode(lived.path)
    assert (episode.frames, episode.outcome, lived.dropped) == (60, SUCCESS, {})
    assert episode.segments == (Segment(kind="demonstration", start=0, stop=30, actor="expert"),
                                Segment(kind="intervention", start=30, stop=60, actor="operator-1"))
    assert read_attachments(lived.path) == attachments


def test_segments_decided_at_the_end_win(tmp_path, trace, start, row):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        for tick in range(10):
            recorder.tick(tick, row(trace(), tick))
        whole = Segment(kind="intervention", start=0, stop=10, actor="operator-2")
        assert recorder.close(SUCCESS, (whole,)).episode.segments == (whole,)


def test_every_tool_reads_it_with_its_pictures(lived, picture):
    with AnyReader([lived.path]) as reader:
        found = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    joys = [m for topic, m in found if topic == "/teleop/joy"]
    images = [m for topic, m in found if topic == "/camera/front/image/compressed"]
    assert len(joys) == len(images) == 60
    assert (list(joys[0].axes), list(joys[0].buttons)) == ([0.5, -1.0], [1, 0, 1])
    assert (images[0].format, images[0].header.frame_id) == ("jpeg", "front")
    decoded = simplejpeg.decode_jpeg(bytes(images[0].data)).astype(int)
    assert np.abs(decoded - picture).mean() < 3
    with lived.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        messages = sum(1 for _ in reader.iter_messages())
        assert reader.get_summary().statistics.message_count == messages


def test_what_it_is_stands_before_the_first_message(lived, attachments):
    with lived.path.open("rb") as stream:
        kinds = []
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                break
            kinds += [record.name] if isinstance(record, Metadata | Attachment) else []
    assert kinds == ["episode_start", *attachments]


def test_stamps_are_those_of_the_robot_and_log_times_those_of_the_recorder(tmp_path, trace, start, row):
    now = iter(range(10_000, 20_000))
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, clock=lambda: next(now)) as recorder:
        for tick in range(5):
            recorder.tick(tick, row(trace(), tick), stamp_ns=1_000 + tick)
        recorder.close(SUCCESS)
    with (tmp_path / "a.mcap").open("rb") as stream:
        found = [(m.publish_time, m.sequence) for _, c, m in make_reader(stream).iter_messages()
                 if c.topic == "/joint_states" and m.log_time >= 10_000]
    assert found == [(1_000 + tick, tick) for tick in range(5)]


def test_a_camera_that_gives_jpeg_is_not_encoded_again(tmp_path, trace, start, row, picture):
    data = simplejpeg.encode_jpeg(picture)
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        recorder.image("wrist", data, tick=0)
        recorder.tick(0, row(trace(), 0))
        recorder.close(SUCCESS)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        (image,) = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if "camera" in c.topic]
    assert bytes(image.data) == data


def test_a_real_robot_has_no_simulator_and_measures_less(tmp_path, trace, start, bare_row):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        for tick in range(60):
            recorder.tick(tick, bare_row(trace(), tick))
        recorder.close(SUCCESS)
    episode, back = read_episode(tmp_path / "a.mcap")
    assert back.frames().state.tobytes() == trace().frames().state.tobytes()
    assert (back.sim_state.shape, back.controller.shape, back.links) == ((60, 0), (60, 0), ())
    assert np.isnan(back.joint_velocity).all() and back.joint_effort.shape == (60, 7)
    assert read_frames(tmp_path / "a.mcap")[0] == episode


def test_a_robot_with_other_joints_is_recorded_but_is_not_the_arm(tmp_path, start):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, layout=joint_layout(["hip", "knee"])) as recorder:
        for tick in range(20):
            recorder.tick(tick, np.array([0.1, 0.2, 0.3, tick]))
        recorder.close(SUCCESS)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        found = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/joint_commands"]
    assert (found[7].name, list(found[7].position)) == (["hip", "knee"], [0.3, 7.0])
    with pytest.raises(RecordingError, match="topic /ee/measured, required by contract 'arm', is missing"):
        read_frames(tmp_path / "a.mcap")


def test_it_has_no_name_before_it_is_whole_and_nobody_touches_it(tmp_path, trace, start, row):
    path = tmp_path / "a.mcap"
    with LiveRecorder(path, start(), attachments={}) as recorder:
        recorder.tick(0, row(trace(), 0))
        time.sleep(0.2)
        assert not path.exists()
        assert recover(tmp_path) == []
        with pytest.raises(RecordingError, match="is being written by another process"):
            LiveRecorder(path, start(), attachments={})
        recorder.close(SUCCESS)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    with pytest.raises(RecordingError, match=r"already there\n.*\n.*name another file"):
        LiveRecorder(path, start(), attachments={})


def test_leaving_without_a_word_leaves_it_for_recovery(tmp_path, trace, start, row, picture):
    with pytest.raises(ZeroDivisionError), LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        for tick in range(40):
            if tick == 25:
                recorder.segment("intervention", "operator-1", tick=tick)
            recorder.image("front", picture, tick=tick)
            recorder.tick(tick, row(trace(), tick))
        raise ZeroDivisionError
    with pytest.raises(RecordingError, match=r"killed recording left has this name\n.*\n  mend: hardcase recover "):
        LiveRecorder(tmp_path / "a.mcap", start(), attachments={})
    (done,) = recover(tmp_path)
    assert (done.frames, "never closed; 40 ticks kept" in done.reason) == (40, True)
    episode, back = read_episode(done.kept)
    assert (episode.outcome.label, episode.frames, len(back)) == ("unknown", 40, 40)
    assert [(s.kind, s.start, s.stop) for s in episode.segments] == [("demonstration", 0, 25), ("intervention", 25, 40)]
    with done.kept.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        topics = [c.topic for _, c, _ in reader.iter_messages()]
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert topics.count("/camera/front/image/compressed") == 40
    assert metadata["episode"]["truncated"] == "true"


def test_nothing_at_all_leaves_no_file(tmp_path, start):
    with (LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder,
          pytest.raises(RecordingError, match="no tick was recorded")):
        recorder.close(SUCCESS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("call", "message"), [
    (lambda r, row: r.write("/nothing", b""), r"topic /nothing is not of the dialect\n.*\n  mend: use one of: /rob"),
    (lambda r, row: r.write("/joint_states", b""), r"once a tick\n.*\n  mend: give it to LiveRecorder.tick"),
    (lambda r, row: r.image("front", np.zeros((4, 4), np.uint8)), r"uint8 of shape \(4, 4\)\n.*\n  mend: give RGB"),
    (lambda r, row: r.image("front", b"GIF89a"), r"bytes that are no JPEG\n.*\n  mend: give RGB"),
    (lambda r, row: r.tick(1, row(links=("a",), link_poses=np.zeros((1, 7)))), r"tick 1 is laid out otherwise"),
    (lambda r, row: r.tick(1, np.zeros(3)), r"tick 1 is laid out otherwise"),
], ids=["topic", "topic of a tick", "grey picture", "gif", "other links", "vector"])
def test_what_does_not_fit_is_refused_at_once(tmp_path, trace, start, bare_row, call, message):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        recorder.tick(0, bare_row(trace(), 0))
        with pytest.raises(RecordingError, match=message):
            call(recorder, lambda **other: bare_row(trace(), 1, **other))
        recorder.tick(1, bare_row(trace(), 1))
        assert recorder.close(SUCCESS).episode.frames == 2, "the recording goes on"


def test_a_row_of_another_robot_is_refused_at_once(tmp_path, trace, start, bare_row):
    with (LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder,
          pytest.raises(RecordingError, match=r"row.action has shape \(4,\), a tick of the arm needs \(5,\)")):
        recorder.tick(0, bare_row(trace(), 0, action=np.zeros(4)))


def test_further_messages_are_those_that_were_written(tmp_path, trace, start, row):
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}) as recorder:
        recorder.tick(0, row(trace(), 0))
        recorder.write("/touch/thumb", cdr.Builder().floats(1).payload(), tick=0)
        recorder.event("limit", "joint 3 held", level=30, tick=0)
        recorder.close(SUCCESS)
    (event,) = read_episode(tmp_path / "a.mcap")[1].events
    assert (event.tick, event.level, event.name, event.text) == (0, 30, "limit", "joint 3 held")


@pytest.mark.parametrize("jump_s", [-3600, 3600], ids=["back", "forward"])
def test_a_clock_that_somebody_sets_does_not_break_the_order(tmp_path, trace, start, row, jump_s):
    base = time.time_ns()
    times = iter([*range(0, 40), *range(jump_s * 10**9, jump_s * 10**9 + 1000)])
    with LiveRecorder(tmp_path / "a.mcap", start(), attachments={}, clock=lambda: base + next(times)) as recorder:
        for tick in range(60):
            recorder.tick(tick, row(trace(), tick))
        recorder.close(SUCCESS)
    assert read_episode(tmp_path / "a.mcap")[1].state.tobytes() == trace().state.tobytes()
