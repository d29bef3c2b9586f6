"""Signals of one tick: from the champion's plan, the candidates' answers, and nothing else."""

import numpy as np
import pytest

from pipeline.disagreement import ACTION_SCALE, disagreement
from pipeline.policies.ensembling import DECAY, Ensembler
from pipeline.signals.neighbours import Neighbours
from pipeline.signals.tick import NAMES, Signals, plan_of, planned
from pipeline.simulation.expert import Expert

IDS = np.arange(3)
SILENT = np.full((3, 5), np.nan)


@pytest.fixture(scope="module")
def neighbours(observations):
    seen = observations(50)
    return Neighbours.among(seen.state.astype(np.float32), seen.environment.astype(np.float32))


@pytest.fixture
def action():
    return np.tile(ACTION_SCALE * [0.5, 0.0, -0.5, 0.2, 1.0], (3, 1))


def test_all_signals_are_told_where_everything_is_known(observations, neighbours, action):
    found = Signals(3, neighbours).tick(observations(3), action, {"a": action}, IDS, action)
    assert tuple(found) == NAMES
    assert all(values.shape == (3,) for values in found.values())


def test_nobody_rides_and_nothing_is_known_of_the_training_data(observations, action):
    assert Signals(3).tick(observations(3), action, {}, IDS, None) == {}
    assert list(Signals(3).tick(observations(3), action, {}, IDS, action)) == ["revision"]


def test_a_candidate_that_means_the_same_is_not_apart(observations, action):
    found = Signals(3).tick(observations(3), action, {"a": action, "b": action}, IDS, None)
    for name in ("apart", "spread", "flips"):
        assert found[name] == pytest.approx(np.zeros(3), abs=1e-12)


def test_apart_is_the_nearest_candidate_so_that_one_bad_one_says_nothing(observations, action):
    bad, near = action + 10 * ACTION_SCALE, action + 0.1 * ACTION_SCALE
    found = Signals(3).tick(observations(3), action, {"bad": bad, "near": near}, IDS, None)
    assert found["apart"].tolist() == disagreement(near, action).tolist()
    pair = np.stack([action, bad, near]) / ACTION_SCALE
    assert found["spread"] == pytest.approx(pair.std(axis=0).mean(axis=1))


def test_a_gripper_that_would_go_the_other_way_is_a_flip(observations, action):
    closing = action.copy()
    closing[1, 4] = 0.0
    found = Signals(3).tick(observations(3), action, {"a": closing, "b": action}, IDS, None)
    assert found["flips"].tolist() == [0, 0.5, 0]


@pytest.mark.parametrize("answer", [SILENT, np.full((3, 5), np.inf)], ids=["silent", "infinite"])
def test_a_candidate_without_an_answer_changes_nothing(observations, action, answer):
    heard = action + 0.1 * ACTION_SCALE
    alone = Signals(3).tick(observations(3), action, {"a": heard}, IDS, None)
    both = Signals(3).tick(observations(3), action, {"a": heard, "b": answer}, IDS, None)
    nobody = Signals(3).tick(observations(3), action, {"b": answer}, IDS, None)
    for name in ("apart", "spread", "flips"):
        assert both[name] == pytest.approx(alone[name])
        assert np.isnan(nobody[name]).all()


def test_the_plan_is_the_mean_of_what_earlier_chunks_said_of_this_tick():
    rng, chunk = np.random.default_rng(0), 4
    ensembler, chunks = Ensembler(chunk, 5, DECAY), rng.normal(size=(7, 2, 4, 5))
    ensembler.reset(2)
    ids = np.arange(2)
    for tick, now in enumerate(chunks):
        told = planned(ensembler.memory(ids))
        ages = range(1, min(tick, chunk - 1) + 1)
        if ages:
            weights = np.exp(-DECAY * np.array(ages))
            said = np.stack([chunks[tick - age][:, age] for age in ages])
            assert told == pytest.approx((weights[:, None, None] * said).sum(axis=0) / weights.sum())
        else:
            assert np.isnan(told).all()
        ensembler.step(now, ids)


def test_who_plans_no_chunks_revises_none():
    expert = Expert()
    expert.reset(1)
    assert plan_of(expert, np.arange(1)) is None
