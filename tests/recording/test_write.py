"""Written recordings, opened by everybody else's readers, and what a disk that refuses leaves behind."""

import errno
import fcntl
import hashlib
import io
import json
import os
import resource
import subprocess
import sys
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from pipeline.errors import RecordingError
from pipeline.recording import Recording, read_episode, write_episode, write_episodes
from pipeline.recording.dialect import EPOCH_NS
from schemas.consent import Consent
from schemas.episode import Episode


def decoded(path: Path) -> dict[str, list]:
    """Topic -> (message record, ROS message) as mcap's own seeking reader and ROS 2 decoder give them."""
    found: dict[str, list] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, ros in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message, ros))
    return found


def test_mcap_and_its_ros2_decoder_read_every_topic(recording, trace):
    trace, found = trace(), decoded(recording)
    assert [list(ros.position) for _, ros in found["/joint_states"]] == trace.state[:, :7].tolist()
    assert [list(ros.velocity) for _, ros in found["/joint_states"]] == trace.joint_velocity.tolist()
    assert [list(ros.effort) for _, ros in found["/joint_states"]] == trace.joint_effort.tolist()
    assert found["/joint_states"][0][1].name == [*(f"joint{k}" for k in range(1, 7)), "gripper"]
    assert [list(ros.position) for _, ros in found["/joint_commands"]] == trace.joint_action.tolist()
    for topic, rows in {"/command/ee": trace.action, "/ee/measured": trace.state[:, 7:11],
                        "/ee/commanded": trace.state[:, 11:], "/observation/environment": trace.environment,
                        "/sim/state": trace.sim_state, "/sim/controller": trace.controller}.items():
        assert [list(ros.data) for _, ros in found[topic]] == rows.tolist(), topic
    assert [ros.data for _, ros in found["/reward/reach"]] == trace.reward["reach"].tolist()
    shadow = trace.shadows["0123456789abcdef"]
    assert [ros.data for _, ros in found["/policy/0123456789abcdef/disagreement"]] == shadow.disagreement.tolist()
    assert [(m.sequence, ros.data) for m, ros in found["/task/phase"]] == [(0, "reach"), (30, "lift")]
    assert [(m.sequence, ros.level, ros.name, ros.msg) for m, ros in found["/events"]] == [
        (20, 20, "note", "it began"), (59, 30, "stall", "kein Fortschritt für 30 Takte")]


def test_poses_name_the_links_and_turn_by_the_perceived_yaw(recording, trace):
    trace, found = trace(), decoded(recording)
    last = found["/tf"][-1][1].transforms
    assert [t.child_frame_id for t in last] == list(trace.links)
    for transform, pose in zip(last, trace.link_poses[-1], strict=True):
        t, q = transform.transform.translation, transform.transform.rotation
        assert [t.x, t.y, t.z, q.w, q.x, q.y, q.z] == pose.tolist()
    pose = found["/observation/object"][9][1].pose
    assert [pose.position.x, pose.position.y, pose.position.z] == trace.environment[9, :3].tolist()
    assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(trace.environment[9, 3], abs=1e-12)


def test_the_description_comes_first_and_stamps_count_ticks(recording, attachments):
    with recording.open("rb") as stream:
        messages = [m for _, _, m in make_reader(stream).iter_messages(log_time_order=False)]
    found = decoded(recording)
    first, urdf = found["/robot_description"][0]
    assert (messages[0].channel_id, first.log_time) == (first.channel_id, EPOCH_NS)
    assert urdf.data.encode() == attachments["robot.urdf"]
    assert [m.log_time - EPOCH_NS for m, _ in found["/joint_states"]] == [t * 50_000_000 for t in range(60)]
    stamp = found["/joint_states"][59][1].header.stamp
    assert stamp.sec * 1_000_000_000 + stamp.nanosec == EPOCH_NS + 59 * 50_000_000
    assert [m.log_time for m in messages] == sorted(m.log_time for m in messages)


def test_every_record_passes_the_stream_reader_with_crcs(recording):
    kinds = [type(r).__name__ for r in StreamReader(io.BytesIO(recording.read_bytes()), validate_crcs=True).records]
    assert kinds.count("Message") == 60 * 15 + 5
    assert (kinds[0], kinds[-1]) == ("Header", "Footer")


def test_the_index_finds_a_single_moment(recording):
    at = EPOCH_NS + 40 * 50_000_000
    with recording.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = list(reader.iter_messages(topics=["/command/ee"], starting_at=at, ending_at=at))
        statistics = reader.get_summary().statistics
    assert [m.sequence for _, _, m in found] == [40]
    assert (statistics.message_count, statistics.attachment_count) == (60 * 15 + 5, 4)
    assert statistics.message_end_time == EPOCH_NS + 59 * 50_000_000


def test_rosbags_reads_every_message(recording, trace):
    with AnyReader([recording]) as reader:
        states = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/joint_states"]
        assert sum(c.msgcount for c in reader.connections) == 60 * 15 + 5
    np.testing.assert_array_equal([s.position for s in states], trace().state[:, :7])


def test_rerun_opens_it_with_named_joints_and_moving_links(recording):
    from rerun.chunk import McapReader

    columns: dict[str, set[str]] = {}
    rows: dict[str, int] = {}
    for chunk in McapReader(recording).stream():
        batch = chunk.to_record_batch()
        columns.setdefault(str(chunk.entity_path), set()).update(batch.schema.names)
        if any("Scalars" in name for name in batch.schema.names):
            rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + batch.num_rows
    assert rows["/joint_states/position"] == 60
    assert any("child_frame" in name for name in columns["/tf"])
    assert any("TextLog" in name for name in columns["/events"])


def test_metadata_says_who_what_and_how_it_ended(recording):
    with recording.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert record.name == "episode"
    said = record.metadata
    expected = {"robot": "arm", "task": "pick-place", "operator": "operator-1", "consent": "simulated",
                "outcome": "failure", "seed": "7", "control_hz": "20.0", "truncated": "false"}
    assert {key: said[key] for key in expected} == expected
    assert said["simulator_version"].startswith("mujoco 4")
    assert Episode.model_validate_json(said["episode_json"]).id == "00112233445566aa"


def said_by(path):
    with path.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    return {key: record.metadata[key] for key in ("consent", "operator", "site", "purpose", "expires")}


def test_metadata_says_whose_consent_a_recording_rests_on(tmp_path, episode, trace, attachments):
    form = Consent(id="form-12", operator="ada", site="lab-2", purposes=("training", "review"),
                   given=date(2026, 1, 1), expires=date(2026, 12, 31))
    person = episode().model_copy(update={"consent": "form-12"})
    for consent, site, purpose, expires in ((form, "lab-2", "training,review", "2026-12-31"), (None, *["unknown"] * 3)):
        write_episode(tmp_path / "a.mcap", person, trace(), attachments=attachments, consent=consent)
        assert said_by(tmp_path / "a.mcap") == {
            "consent": "form-12", "operator": "ada" if consent else "operator-1", "site": site, "purpose": purpose,
            "expires": expires}
    with pytest.raises(RecordingError, match=r"refers to consent 'simulated', not to 'form-12'\n.*\n  mend: set "):
        write_episode(tmp_path / "b.mcap", episode(), trace(), attachments=attachments, consent=form)


def test_a_simulated_recording_says_so_and_names_nobody(tmp_path, episode, trace, attachments):
    acted = tuple(s.model_copy(update={"kind": "demonstration", "actor": "expert"}) for s in episode().segments)
    path = tmp_path / "a.mcap"
    write_episode(path, episode().model_copy(update={"segments": acted}), trace(), attachments=attachments)
    said = said_by(path)
    assert said.pop("operator") == "expert"
    assert said == dict.fromkeys(("consent", "site", "purpose", "expires"), "simulated")


def test_attachments_travel_with_the_file(recording, attachments):
    with recording.open("rb") as stream:
        found = {a.name: (a.media_type, a.data) for a in make_reader(stream).iter_attachments()}
    assert {name: data for name, (_, data) in found.items()} == attachments
    assert found["scene.xml"][0] == "application/xml"


def test_the_same_episode_gives_the_same_bytes(tmp_path, episode, trace, attachments):
    digests = [write_episode(tmp_path / f"{k}.mcap", episode(), trace(), attachments=attachments) for k in range(2)]
    assert digests[0] == digests[1] == hashlib.sha256((tmp_path / "1.mcap").read_bytes()).hexdigest()
    blob = episode().model_copy(update={"blob": digests[0]})
    assert write_episode(tmp_path / "2.mcap", blob, trace(), attachments=attachments) == digests[0]


def test_many_are_written_in_order_and_nothing_is_left_over(tmp_path, episode, trace):
    items = [Recording(tmp_path / f"{k}.mcap", episode(), trace(seed=k), {}) for k in range(20)]
    digests = write_episodes(items)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(i.path.name for i in items)
    assert digests == [hashlib.sha256(i.path.read_bytes()).hexdigest() for i in items]


def test_a_full_disk_is_one_error_and_leaves_nothing(tmp_path, episode, trace):
    part = tmp_path / "a.mcap.part"
    part.symlink_to("/dev/full")  # the kernel's own full disk
    with pytest.raises(RecordingError, match=r"No space left on device\n.*a\.mcap\n.*hardcase gc") as caught:
        write_episode(tmp_path / "a.mcap", episode(), trace(), attachments={})
    assert caught.value.__cause__.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


LIMITED = """
import resource, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import make_episode, make_trace
from pipeline.errors import RecordingError
from pipeline.recording import Recording, write_episodes
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
folder = Path(sys.argv[1])
items = [Recording(folder / f"{m}.mcap", make_episode(m), make_trace(m), {}) for m in (10, 20, 900)]
try:
    write_episodes(items)
except RecordingError as error:
    print(error)
"""


def test_a_quota_in_the_middle_of_a_batch_leaves_none_of_it(tmp_path):
    done = subprocess.run([sys.executable, "-c", LIMITED, str(tmp_path), str(Path(__file__).parent)], text=True,
                          capture_output=True, check=True, env=os.environ | {"PYTHONPATH": str(Path.cwd())})
    assert "File too large" in done.stdout and "900.mcap" in done.stdout and "HARDCASE_STORE" in done.stdout
    assert list(tmp_path.iterdir()) == []
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 200_000


def test_a_failed_write_leaves_the_old_file(recording, episode, trace):
    before = recording.read_bytes()
    recording.with_name("a.mcap.part").symlink_to("/dev/full")
    with pytest.raises(RecordingError):
        write_episode(recording, episode(), trace(seed=1), attachments={})
    assert recording.read_bytes() == before


def test_a_disk_below_the_reserve_is_refused_before_the_start(tmp_path, episode, trace):
    with pytest.raises(RecordingError, match=r"MiB free, .* must leave \d+ MiB\n.*\n  mend: .*hardcase gc"):
        write_episode(tmp_path / "a.mcap", episode(), trace(), attachments={}, reserve_bytes=1 << 60)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path, episode, trace):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"Not a directory|File exists"):
        write_episode(tmp_path / "file" / "a.mcap", episode(), trace(), attachments={})


def test_two_writers_of_one_file_do_not_mix(tmp_path, episode, trace):
    part = tmp_path / "a.mcap.part"
    with part.open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(RecordingError, match=r"another process\n.*\n  mend: wait for the other loop"):
            write_episode(tmp_path / "a.mcap", episode(), trace(), attachments={})
        assert part.exists(), "the other's file is not ours to remove"


@pytest.mark.parametrize(("frames", "changed", "message"), [
    (59, {}, "trace has 60 ticks at 20.0 Hz, its episode says 59"),
    (60, {"action": np.zeros((60, 4))}, r"trace.action has shape \(60, 4\), a trace of 60 ticks needs \(60, 5\)"),
    (60, {"phase": ("reach",)}, r"trace.phase has shape \(1,\)"),
    (60, {"reward": {"reach": np.zeros(61)}}, r"trace.reward\[reach\] has shape \(61,\)"),
], ids=["length", "width", "phase", "reward"])
def test_a_trace_that_does_not_fit_is_refused(tmp_path, episode, trace, frames, changed, message):
    import dataclasses

    with pytest.raises(RecordingError, match=message):
        write_episode(tmp_path / "a.mcap", episode(frames), dataclasses.replace(trace(), **changed), attachments={})
    assert list(tmp_path.iterdir()) == []


def test_a_name_without_mcap_is_refused(tmp_path, episode, trace):
    with pytest.raises(RecordingError, match=r"mend: write to a\.mcap"):
        write_episode(tmp_path / "a.bag", episode(), trace(), attachments={})


def test_json_of_an_episode_keeps_every_bit_of_its_numbers(recording, episode):
    found, _ = read_episode(recording)
    assert found == episode().model_copy(update={"blob": found.blob})
    assert json.loads(found.model_dump_json())["scene"]["draws"][0]["value"] == 0.1 + 0.2
