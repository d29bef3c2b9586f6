"""`hardcase teleop --ring`: a policy is watched, and what a person did about it is kept whole."""

import json

import pytest

from flows.teleop.devices import TeleopOrder
from flows.teleop.teleoperation import run_teleop
from pipeline.errors import ConfigError
from pipeline.recording import read_episode
from pipeline.store import Store


@pytest.fixture
def order(tmp_path, plugins_everywhere):
    """A session with a virtual pad whose keys are given by rows, as fast as it goes."""

    def made(rows, **options) -> TeleopOrder:
        (tmp_path / "hand.json").write_text(json.dumps(rows))
        keys = {"hand": str(tmp_path / "hand.json"), "calibration_dir": str(tmp_path)}
        return TeleopOrder(teleop="lerobot:virtual_pad", teleop_keys=keys, speed=0.0, operator="p1", ring=True,
                           **options)

    return made


def test_a_takeover_is_kept_at_full_rate_with_what_was_before_and_after(order, tmp_path):
    taken = [{"delta_z": 1.0, "is_intervention": 1}] * 150  # longer than what a ring keeps after a trigger
    run_teleop(order([{}] * 8 + taken + [{}] * 8 + [{"success": 1}], policy="expert", by_key=True), tmp_path / "store")
    with Store.open(tmp_path / "store") as store:
        thin, window = store.episodes(origin="teleop")
        trace = read_episode(store.blob(window.blob))[1]
    assert (thin.control_hz, thin.frames) == (2.0, 17) and window.control_hz == 20.0
    assert [(s.kind, s.start, s.stop) for s in window.segments] == [
        ("autonomous", 0, 8), ("intervention", 8, 158), ("autonomous", 158, 167)]
    assert len(trace) == 167 and trace.action[8:158, 2].min() > 0
    assert (window.outcome.label, window.outcome.trigger, window.outcome.tick) == ("success", "take-over", 8)


def test_a_demonstration_is_kept_whole_and_the_mend_says_what_to_name(order, tmp_path):
    with pytest.raises(ConfigError, match=r"a demonstration is kept whole(.|\n)*mend: name who is watched: --policy"):
        run_teleop(order([{}]), tmp_path / "store")
