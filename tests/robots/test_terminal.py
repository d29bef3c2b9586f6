"""A person at a terminal: real keys through a pseudo-terminal, the real command, a store on the disk."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from flows.teleop.devices import TeleopOrder
from flows.teleop.teleoperation import run_teleop
from pipeline.errors import HardcaseError
from pipeline.recording import read_attachments, read_episode
from pipeline.robots.keyboard import AXES, BUTTONS

FAST = ("--speed", "5")


def joys(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages(topics=["/teleop/joy"])]


def test_a_person_picks_and_places_by_keyboard_and_the_recording_is_whole(terminal, person, store):
    child = terminal(*FAST, "--operator", "p7", "--consent", "form-7")
    child.wait_for("RESET")
    child.press("\r")
    child.wait_for("YOU")
    person(child).work()
    code, table = child.end()
    assert code == 0, child.screen[-800:]
    (episode,) = store.episodes()
    assert episode.id in table and "success" in table
    assert (episode.origin, episode.consent, episode.policy) == ("teleop", "form-7", None)
    assert (episode.outcome.label, episode.outcome.judged_by) == ("success", "simulator")
    assert [(s.kind, s.actor) for s in episode.segments] == [("demonstration", "p7")]
    read, trace = read_episode(store.blob(episode.blob))
    assert read == episode and len(trace) == episode.frames
    assert np.abs(trace.action[:, :4]).max() <= 0.0451 and trace.phase[-1] == "place"
    recorded = joys(store.blob(episode.blob))
    assert len(recorded) == episode.frames
    named = json.loads(read_attachments(store.blob(episode.blob))["config.json"])
    assert (tuple(named["joy_axes"]), tuple(named["joy_buttons"])) == (AXES, BUTTONS)
    closes = [k for k, joy in enumerate(recorded) if joy.buttons[BUTTONS.index("c")]]
    moved = np.array([joy.axes[:2] for joy in recorded])
    assert len(closes) == 1 and np.abs(moved[:closes[0]]).max() == 1.0
    assert trace.action[closes[0], 4] < trace.action[closes[0] - 1, 4], "the press is in the tick that obeys it"


def test_a_person_takes_over_from_a_policy_and_gives_it_back_in_one_episode(terminal, store):
    child = terminal("--speed", "2", "--policy", "expert", "--operator", "p7", "--consent", "form-7")
    child.wait_for("RESET")
    child.press("\r")
    child.wait_for("POLICY")
    child.press("t")
    child.wait_for("YOU")
    for _ in range(4):
        child.press("rd")
        child.look(0.05)
        time.sleep(0.05)
    child.press("t")
    code, _ = child.end()
    assert code == 0, child.screen[-800:]
    (episode,) = store.episodes()
    assert [(s.kind, s.actor) for s in episode.segments] == [
        ("autonomous", "expert"), ("intervention", "p7"), ("autonomous", "expert")]
    assert (episode.outcome.label, episode.outcome.judged_by) == ("success", "simulator")
    read, trace = read_episode(store.blob(episode.blob))
    assert read == episode
    first, taken, last = episode.segments
    assert [e.tick for e in trace.events if e.name == "segment"] == [taken.start, last.start]
    person = trace.action[taken.start:taken.stop]
    assert (person[:, 2] >= 0).all() and person[:, 2].max() > 0 and person[:, 1].min() < 0, "it went where keys said"
    assert (trace.action[first.start:first.stop, 2] < 0).any(), "the expert came down before and after"


def test_labels_by_key_a_reset_between_attempts_and_an_end_by_key(terminal, store):
    child = terminal(*FAST, "--by-key", "--episodes", "9", "--json")
    for attempt, key in enumerate("ynu", start=1):
        child.wait_for(f"{attempt}/9   0.4 s RESET")
        child.press("\r")
        child.wait_for(f"{attempt}/9   0.4 s YOU")
        child.press(key)
    child.wait_for("4/9   0.2 s RESET")
    child.press("x")
    code, printed = child.end()
    assert code == 0, child.screen[-800:]
    episodes = store.episodes()
    assert [(e.outcome.label, e.outcome.judged_by) for e in episodes] == [
        ("success", "operator"), ("failure", "operator"), ("unknown", "operator")]
    assert [e["id"] for e in json.loads(printed)["episodes"]] == [e.id for e in episodes]
    assert len({e.scene.seed for e in episodes}) == 3 and {e.scene.family for e in episodes} == {"teleop"}
    starts = [read_episode(store.blob(e.blob))[1].environment[0, :2] for e in episodes]
    assert all(np.hypot(*(np.array(e.scene.object_xy_m) - at)) < 0.002 for e, at in zip(episodes, starts, strict=True))
    assert {e.consent for e in episodes} == {"none"} and "never used for training" in child.screen


def test_ctrl_c_cuts_the_attempt_off_and_keeps_it(terminal, store):
    child = terminal(*FAST)
    child.wait_for("RESET")
    child.press("\r")
    child.wait_for("1.0 s YOU")
    child.process.send_signal(signal.SIGINT)
    code, table = child.end()
    assert code == 130 and "cut off" in table and "interrupted" in table
    (episode,) = store.episodes()
    assert episode.outcome.label == "unknown" and episode.frames >= 20
    assert read_episode(store.blob(episode.blob))[0] == episode


def test_a_terminal_that_goes_away_ends_the_attempt_and_it_is_kept(terminal, store):
    child = terminal(*FAST)
    child.wait_for("RESET")
    child.press("\r")
    child.wait_for("1.0 s YOU")
    child.hang_up()
    child.process.wait(240)
    (episode,) = store.episodes()
    assert episode.outcome.reason == "cut off: the terminal is gone" and episode.frames >= 20
    assert read_episode(store.blob(episode.blob))[0] == episode


def test_what_a_killed_session_left_is_kept_by_the_next_one(terminal, store):
    child = terminal(*FAST, "--operator", "p7", "--consent", "form-7")
    child.wait_for("RESET")
    child.press("\r")
    child.wait_for("3.0 s YOU")
    child.process.kill()
    child.process.wait()
    again = terminal(*FAST)
    again.wait_for("kept what an earlier session left")
    again.wait_for("RESET")
    again.press("x")
    assert again.end()[0] == 0
    (episode,) = store.episodes()
    assert (episode.outcome.label, episode.consent) == ("unknown", "form-7")
    assert episode.duration_s > 3.0 - 5 * 0.25, "at five times real time, 0.25 s of the clock are 1.25 s of the robot"
    assert read_episode(store.blob(episode.blob))[0].frames == episode.frames


def test_without_a_terminal_the_keyboard_says_so_in_three_lines(store, tmp_path):
    done = subprocess.run([sys.executable, "-m", "flows.cli", "teleop"], capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, env=os.environ | {"HARDCASE_STORE": str(tmp_path / "store")})
    assert done.returncode == 2 and "Traceback" not in done.stderr
    *_, said, at, mend = done.stderr.strip().splitlines()
    assert (said, at) == ("the keyboard needs a terminal", "  at:   standard input") and "ssh -t" in mend
    assert store.episodes() == []


@pytest.mark.parametrize(("options", "what", "mend"), [
    ({"robot": "arn"}, "unknown robot 'arn'", "arm, twin:SEED, lerobot:NAME"),
    ({"teleop": "mouse"}, "unknown teleoperator 'mouse'", "keyboard, gamepad, lerobot:NAME"),
    ({"consent": "form-9"}, "consent form-9 is not in the store", "hardcase consent add"),
    ({"consent": "form-7"}, "consent form-7 is of operator 'p7'", "--operator p7"),
    ({"policy": "champion"}, "no loop of this store has released a policy", "hardcase loop"),
    ({"cameras": ("nose",)}, "unknown camera 'nose'", "front, top"),
    ({"stratum": "odd"}, "unknown stratum 'odd'", "beside, common, large"),
    ({"operator": "Anna Smith"}, "'Anna Smith' is no pseudonym", "never a person's name"),
    ({"task": "juggle"}, "unknown task 'juggle'", "pick-place"),
    ({"robot": "lerobot:virtual_six", "robot_keys": {"port": "x"}, "cameras": ("top",)},
     "--camera is for simulated robots", "--robot-key cameras"),
], ids=lambda value: ", ".join(value) if isinstance(value, dict) else "")
def test_what_cannot_be_done_says_what_can(store, options, what, mend):
    with pytest.raises(HardcaseError) as refused:
        run_teleop(TeleopOrder(**options), store.root)
    assert what in refused.value.what and mend in refused.value.mend
    assert store.episodes() == [] and not list(store.root.rglob("*.part"))
