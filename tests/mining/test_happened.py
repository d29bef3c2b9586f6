"""What happened is told from what a robot senses, and a failure is put down to the subtask in which it went wrong."""

import numpy as np
import pytest

from pipeline.mining.families import agreement, join
from pipeline.mining.happened import FEATURES, described, sensed, subtask
from pipeline.mining.names import named, told

TAUGHT = np.array([[0.30, 0.01, 0.02]])
UP = np.where(np.arange(40) < 20, 0.0, 0.06)
AWAY = np.clip(np.arange(40) - 20, 0, 18) / 100
"""Lifted from tick 20 on, and carried 18 of the 20 cm to the mark."""


@pytest.mark.parametrize(("course", "name", "begins"), [
    ({"tool": 0.12}, "reach", 0),
    ({"tool": np.linspace(0.15, 0.045, 40)}, "grasp", 34),
    ({}, "lift", 3),
    ({"lifted": UP}, "carry", 20),
    ({"lifted": UP, "carried": AWAY}, "place", 36),
], ids=["never near", "near but never held", "held but never lifted", "lifted but never at the mark", "at the mark"])
def test_an_attempt_fails_in_the_first_subtask_that_it_does_not_finish(attempt, course, name, begins):
    assert subtask(sensed(attempt(**course), TAUGHT)) == (name, begins)


def test_fingers_that_are_still_closing_hold_nothing(attempt):
    closing = attempt(opening=np.linspace(0.08, 0.017, 40))
    assert subtask(sensed(closing, TAUGHT))[0] == "grasp"
    assert not sensed(closing, TAUGHT).held.any()


def test_a_family_is_named_by_its_subtask_and_the_signs_that_stood_out(attempt):
    beside = sensed(attempt(tool=0.12, opening=0.005, start=(0.1, 0.27), half=0.031), TAUGHT)
    assert named(beside, ()) == "reach-unlike-large-empty"
    assert named(beside, ("reach-unlike-large-empty",)) == "reach-unlike-large-empty-2"
    assert "tool within 12.0 cm" in told(beside)
    assert "33 cm from any taught" in told(beside)


def points(attempt, *courses):
    return np.array([described(sensed(attempt(**course), TAUGHT)) for course in courses])


def test_failures_that_went_alike_become_one_family_and_others_another(attempt):
    missed = [{"tool": 0.11 + k / 500, "opening": 0.005, "start": (0.1, 0.25 + k / 100)} for k in range(4)]
    slipped = [{"lifted": np.where(np.arange(40) < 20 + k, 0.05, 0.0)} for k in range(3)]
    found = join(points(attempt, *missed, *slipped), np.zeros((0, len(FEATURES))))
    assert found.family.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert found.medoids[0] in range(4)
    assert found.medoids[1] in range(4, 7)


def test_a_later_failure_joins_the_family_it_lies_within_and_a_strange_one_is_new(attempt):
    known = points(attempt, {"tool": 0.11, "opening": 0.005, "start": (0.1, 0.25)})
    later = points(attempt, {"tool": 0.10, "opening": 0.005, "start": (0.1, 0.27)}, {"lifted": UP, "half": 0.031})
    found = join(later, known)
    assert found.family.tolist() == [0, 1]
    assert found.medoids == (1,)
    assert join(known, known).medoids == ()


def test_no_failures_make_no_family():
    found = join(np.zeros((0, len(FEATURES))), np.zeros((0, len(FEATURES))))
    assert found.family.size == 0
    assert found.medoids == ()


def test_agreement_is_one_for_the_same_groups_and_about_zero_for_chance():
    assert agreement(list("aabbc"), [1, 1, 2, 2, 3]) == 1
    # the example of Hubert and Arabie's formula worked by hand: table [[1, 1], [1, 2]], pairs 1 of (1+3)(1+3)/10
    assert agreement(list("aabbb"), list("xyxyy")) == pytest.approx((1 - 1.6) / (4 - 1.6))
    rng = np.random.default_rng(1)
    shuffled = [agreement(rng.integers(3, size=40), rng.integers(3, size=40)) for _ in range(50)]
    assert abs(np.mean(shuffled)) < 0.05
