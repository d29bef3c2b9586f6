"""The queue of corrections: by failures that each is expected to end, near-duplicates folded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.mining.order import Failures, failing, queue

NOWHERE = np.zeros((0, 3))


def failures(starts, family=None, unlike=0.2, again=1.0, chance=0.8):
    n = len(starts)
    return Failures(np.array(starts, float).reshape(n, 3), np.full(n, unlike), np.array(family or [0] * n),
                    np.full(n, again), np.full(n, chance))


LEFT = [(0.10, 0.23 + k / 33, 0.02) for k in range(5)]
RIGHT = [(0.10, -0.25 - k / 33, 0.02) for k in range(3)]


def test_the_first_corrections_go_where_most_failures_are_and_then_elsewhere():
    turns = queue(failures([*RIGHT, *LEFT]), NOWHERE)
    assert turns[0].row == 5  # the middle of the five
    assert turns[1].row == 1  # then the middle of the three, not a second one among the five
    assert turns[0].worth > turns[1].worth > turns[2].worth


def test_what_was_corrected_before_comes_later():
    fresh = queue(failures([*RIGHT, *LEFT]), NOWHERE)
    taught = queue(failures([*RIGHT, *LEFT]), np.array(LEFT))
    assert fresh[0].row in range(3, 8)
    assert taught[0].row in range(3)
    assert next(t for t in taught if t.row == 5).novelty < 0.5


def test_near_duplicates_stand_behind_the_one_that_stands_for_them():
    turns = queue(failures([LEFT[0], (0.101, 0.251, 0.02), (0.099, 0.25, 0.02), RIGHT[0]]), NOWHERE)
    folded = next(t for t in turns if t.folds)
    assert {folded.row, *folded.folds} == {0, 1, 2}
    assert {t.row for t in turns[:2]} == {folded.row, 3}


def test_an_accident_among_successes_is_worth_little():
    solved = np.array([(0.30 + k / 100, 0.0, 0.02) for k in range(-5, 6)])
    again = failing(np.array([(0.30, 0.0, 0.02), (0.10, 0.25, 0.02), (0.30, 0.0, 0.031)]), solved)
    assert again[0] < 0.1  # ten others that began so succeeded
    assert again[1] > 0.99
    assert again[2] > 0.98  # at the same place, but another object


def test_over_known_ground_one_correction_reaches_the_whole_family():
    spread = [(0.25, -0.1, 0.031), (0.36, 0.1, 0.031)]
    known, far = (queue(failures(spread, unlike=u), NOWHERE) for u in (0.01, 0.3))
    assert known[0].worth > 1.9 * far[0].worth * 0.95


@given(st.lists(st.tuples(st.floats(0, 0.4), st.floats(-0.3, 0.3), st.sampled_from([0.02, 0.031])), max_size=12),
       st.integers(0, 3))
def test_every_failure_has_one_place_and_worth_never_rises_among_those_that_stand_for_themselves(starts, kinds):
    turns = queue(failures(starts, family=[k % (kinds + 1) for k in range(len(starts))]), NOWHERE)
    assert sorted(t.row for t in turns) == list(range(len(starts)))
    folded = {k for t in turns for k in t.folds}
    alone = [t.worth for t in turns if t.row not in folded]
    assert alone == sorted(alone, reverse=True) or np.allclose(alone, sorted(alone, reverse=True))
    assert sum(t.worth for t in turns) <= len(starts) + 1e-9


def test_no_failures_make_no_queue():
    assert queue(failures(NOWHERE), NOWHERE) == []


@pytest.mark.parametrize("row", [0, 1])
def test_chance_of_one_family_moves_only_its_own(row):
    both = failures([LEFT[0], RIGHT[0]], family=[0, 1])
    weak = Failures(both.start, both.unlike_m, both.family, both.again, np.array([0.2, 0.8]))
    assert queue(weak, NOWHERE)[row].row == 1 - row
