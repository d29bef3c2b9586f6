"""What counts as the same motion, and what only looks so."""

import dataclasses

import pytest

from pipeline.check.contract import completed
from pipeline.check.identity import Motion, motion_of, same_motion
from pipeline.check.load import read_recording
from schemas.contract import Contract, Thresholds


@pytest.fixture(scope="module")
def motions(demos):
    subjects = [read_recording(path) for path in demos[:3]]
    return [motion_of(s.recordings[0], completed(Contract(), s)) for s in subjects]


def test_different_demonstrations_are_different(motions):
    assert same_motion(motions, Thresholds()) == []


def test_a_copy_under_another_name_is_the_same(motions):
    copy = dataclasses.replace(motions[0], name="again", lineage="another")
    (twins,) = same_motion([*motions, copy], Thresholds())
    assert (twins.first, twins.second, twins.distance) == (0, 3, 0)


def test_a_copy_with_four_digits_is_nearly_the_same(motions):
    rounded = dataclasses.replace(motions[1], shape=motions[1].shape.round(4), rows=motions[1].rows[:0], digest="",
                                  lineage="another")
    (twins,) = same_motion([*motions, rounded], Thresholds())
    assert twins.first == 1 and "of the motion's range only" in twins.what


def test_a_correction_may_hold_the_attempt_that_it_grew_from_but_a_stranger_may_not(motions):
    grown = dataclasses.replace(motions[0], name="correction", shape=motions[2].shape, digest="")
    assert same_motion([motions[0], grown], Thresholds()) == []
    stranger = dataclasses.replace(grown, lineage="another")
    (twins,) = same_motion([motions[0], stranger], Thresholds())
    assert twins.what == f"shares 100% of its rows with {motions[0].name}"


def test_a_motion_crosses_from_a_child_process_whole(motions):
    again = Motion.of(motions[0].plain())
    assert (again.shape == motions[0].shape).all() and (again.rows == motions[0].rows).all()
    assert (again.name, again.lineage, again.digest) == (motions[0].name, motions[0].lineage, motions[0].digest)
