"""Poisons say what is wrong with them; the influence score is the derivative that it claims to be."""

import numpy as np
import pytest
import torch

from flows.data.consents import consents_now
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.influence import Influence, Tried, conjugate_gradient, shares_of
from pipeline.policies.training import Fitted, fit
from pipeline.simulation.tasks import load_task
from pipeline.worth.cupid import by_episode
from pipeline.worth.poison import POISONS, SHIFT_TICKS


@pytest.fixture
def data(steps):
    return TrainingData.load(steps.store.path(steps.material.version(1).path), consents_now(steps.store))


@pytest.fixture
def tried(data):
    rng = np.random.default_rng(3)
    rows = np.sort(data.rows["base"])[:60]
    return Tried(data.state[rows], data.environment[rows], rng.standard_normal((60, 5)).astype(np.float32),
                 np.repeat([0, 1], 30), np.array([0.5, -0.5], np.float32))


def test_every_poison_changes_what_it_says_and_nothing_else(steps):
    good = steps.material.frames(steps.store.episodes(steps.material.ids(0, "collect"))[0])
    bad = {name: poison(good, load_task("pick-place"), np.random.default_rng(1)) for name, poison in POISONS.items()}
    assert all(np.array_equal(b.state, good.state) for b in bad.values())
    assert np.array_equal(bad["negated"].action[:, :4], -good.action[:, :4])
    assert np.array_equal(bad["negated"].action[:, 4], good.action[:, 4])
    assert np.array_equal(bad["shifted"].action[SHIFT_TICKS:], good.action[:-SHIFT_TICKS])
    assert np.array_equal(np.sort(bad["permuted"].action, 0), np.sort(good.action, 0))
    moved = bad["other-task"].environment[0, 4:6] - good.environment[0, 4:6]
    assert np.hypot(*moved) >= 0.1 and np.array_equal(bad["other-task"].action, good.action)


def test_influence_is_the_derivative_of_the_loss_along_its_direction(data, steps, tried):
    fitted = fit(data, steps.recipe.train, 1)
    influence = Influence(fitted, tried, data)
    batch = data.held_out(8) if data.held_out_rows.size else data.training(8)
    found = influence.of(batch)

    def loss(step):
        weights = {name: w.copy() for name, w in fitted.weights.items()}
        for name, along in influence.direction.items():
            weights[f"layers.{name}"] = weights[f"layers.{name}"] + step * along.numpy()
        moved = Fitted(fitted.shape, weights, fitted.action_mean, fitted.action_std, (), ())
        features, target, keep = influence._tensors(batch)
        with torch.no_grad():
            out = moved.network().layers(features) * keep
        return torch.nn.functional.smooth_l1_loss(out, target, reduction="none").sum(1).double().numpy()

    scale = 1e-2 / max(float(torch.cat([d.flatten() for d in influence.direction.values()]).norm()), 1e-9)
    measured = -(loss(scale) - loss(-scale)) / (2 * scale)
    assert np.corrcoef(found, measured)[0, 1] > 0.999
    assert np.allclose(found, measured, rtol=0.05, atol=0.02 * np.abs(found).max())


def test_what_a_chunk_answers_for_adds_up_to_the_noise_of_every_action(tried):
    shares = shares_of(tried, 8)
    total = np.zeros((60, 5))
    for row in range(60):
        for age in range(8):
            if row - age >= 30 * (row // 30):
                total[row] += shares[row - age, age]
    assert np.allclose(total, tried.noise * tried.advantage[tried.attempt][:, None], atol=1e-5)


def test_conjugate_gradients_solve_what_they_are_given():
    rng = np.random.default_rng(4)
    half = rng.normal(size=(12, 12))
    matrix, b = torch.tensor(half @ half.T + np.eye(12)), torch.tensor(rng.normal(size=12))
    assert torch.allclose(matrix @ conjugate_gradient(lambda v: matrix @ v, b), b, atol=1e-4)


def test_an_episode_scores_as_often_as_training_draws_it(data, steps):
    rows = np.sort(np.concatenate(list(data.rows.values())))
    scores = by_episode(np.ones(rows.size), rows, data, steps.material.version(1).episodes)
    assert sum(scores.values()) == pytest.approx(1.0)
