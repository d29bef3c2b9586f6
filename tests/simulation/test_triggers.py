"""Triggers: each notices its own failure in a short made-up story, and none fires on a success."""

import numpy as np
import pytest

from pipeline.frames import ENVIRONMENT, STATE
from pipeline.protocols import Observation
from pipeline.triggers import TRIGGERS, Senses, family, fired, stratum_of
from schemas.recipe import HarvestConfig

CONFIG = HarvestConfig()
TICKS = 150
IDS = np.array([0])
CUBE, TARGET = np.array([0.30, 0.05, 0.02]), np.array([0.30, -0.10, 0.0])
OPEN, HELD, SHUT = 0.08, 0.04, 0.002


def senses(ticks: int = TICKS) -> Senses:
    return Senses(1, ticks, CONFIG, within_m=0.025, away_m=0.05, open_m=0.066, low_m=0.006, hold=4)


def moment(tool, cube, opening, asked) -> Observation:
    state, seen = np.zeros((1, len(STATE))), np.zeros((1, len(ENVIRONMENT)))
    state[0, STATE.index("ee_x"):STATE.index("ee_z") + 1] = tool
    state[0, STATE.index("gripper")], state[0, STATE.index("cmd_gripper")] = opening, asked
    seen[0, :3], seen[0, 4:7] = cube, TARGET
    return Observation(state, seen)


def tell(story, s: Senses | None = None) -> tuple[list[str], Senses]:
    """What fired, tick by tick ('' for nothing), and the senses at the end."""
    s, names = s or senses(), list(TRIGGERS)
    heard = []
    for tool, cube, opening, asked in story:
        s.update(moment(np.asarray(tool, float), np.asarray(cube, float), opening, asked), IDS)
        index = fired(s, IDS)[0]
        heard.append(names[index] if index >= 0 else "")
    return heard, s


def reach(n=20):
    return [(np.add(CUBE, [0, 0, 0.2 * (1 - k / n)]), CUBE, OPEN, OPEN) for k in range(n + 1)]


def grasp(n=5):
    return [(CUBE, CUBE, HELD, 0.0)] * n


def carry(n=20):
    way = [CUBE + (TARGET - CUBE) * [1, 1, 0] * (k / n) + [0, 0, 0.08 * np.sin(np.pi * k / n)] for k in range(n + 1)]
    return [(p, p, HELD, 0.0) for p in way]


def let_go(n=12):
    cube = np.array([*TARGET[:2], 0.02])
    return [(np.add(cube, [0, 0, 0.012 * k]), cube, OPEN, OPEN) for k in range(n)]


def test_a_success_fires_nothing_and_is_noticed():
    heard, s = tell(reach() + grasp() + carry() + let_go())
    assert set(heard) == {""}
    assert s.succeeded(IDS)[0]
    assert s.phase(0) == "place"


def test_standing_still_is_a_stall():
    heard, s = tell(reach() + [(CUBE, CUBE, OPEN, OPEN)] * (CONFIG.stall_ticks + 1))
    assert heard.index("stall") == 20 + CONFIG.stall_ticks
    assert s.phase(0) == "reach"


def test_creeping_by_less_than_progress_is_a_stall_too():
    heard, _ = tell([(np.add(CUBE, [0, 0, 1e-4 * k]), CUBE, OPEN, OPEN) for k in range(CONFIG.stall_ticks + 2)])
    assert "stall" in heard


def test_closing_on_nothing_is_noticed_after_its_ticks():
    closing = [(np.add(CUBE, [0.05 + 0.005 * k, 0, 0]), CUBE, SHUT, 0.0) for k in range(12)]
    heard, s = tell(reach() + closing)
    assert heard.index("closed-on-nothing") == 20 + CONFIG.closed_ticks + 1
    assert s.phase(0) == "reach"


@pytest.mark.parametrize("opening", [SHUT, HELD], ids=["fingers met", "fingers still apart"])
def test_losing_the_cube_on_the_way_is_a_drop(opening):
    fallen = [(np.add(CUBE, [0, -0.01 * k, 0.1]), CUBE, opening, 0.0) for k in range(12)]
    heard, s = tell(reach() + grasp() + fallen)
    assert "dropped" in heard
    assert "closed-on-nothing" not in heard
    assert s.phase(0) == "carry"


def test_the_last_tick_without_success_is_a_time_out():
    slow = [(np.add(CUBE, [0.01 * k, 0, 0.1]), CUBE, OPEN, OPEN) for k in range(30)]
    heard, _ = tell(slow, senses(30))
    assert heard == [""] * 29 + ["timed-out"]


def test_a_cube_that_was_only_pushed_to_the_mark_is_a_success_and_a_hand_above_it_is_none():
    cube = np.array([*TARGET[:2], 0.02])
    _, away = tell([(np.add(cube, [0, 0, 0.10 + 0.005 * k]), cube, OPEN, OPEN) for k in range(6)])
    _, above = tell([(np.add(cube, [0, 0, 0.005 * k]), cube, OPEN, OPEN) for k in range(6)])
    assert away.succeeded(IDS)[0]
    assert not above.succeeded(IDS)[0]


def test_attempts_are_counted_apart():
    s = Senses(2, TICKS, CONFIG, within_m=0.025, away_m=0.05, open_m=0.066, low_m=0.006, hold=4)
    for k in range(CONFIG.stall_ticks + 1):
        still, moving = (moment(np.add(CUBE, [0, 0, step * k]), CUBE, OPEN, OPEN) for step in (0, 0.01))
        s.update(Observation(np.vstack([still.state, moving.state]),
                             np.vstack([still.environment, moving.environment])), np.array([0, 1]))
    assert fired(s, np.array([0, 1])).tolist() == [list(TRIGGERS).index("stall"), -1]


@pytest.mark.parametrize(("seen", "stratum"), [
    ((0.3, 0.0, 0.02), "common"), ((0.1, -0.25, 0.02), "beside"), ((0.3, 0.1, 0.031), "large"),
])
def test_the_kind_of_start_is_told_from_what_is_perceived(seen, stratum):
    assert stratum_of(np.array(seen)) == stratum


def test_a_failure_family_names_trigger_and_subtask():
    assert family("dropped", "carry") == "dropped-carry"
