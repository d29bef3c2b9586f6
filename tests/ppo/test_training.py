"""What a training learns, counts and normalises."""

import numpy as np
import pytest

from pipeline.ppo.curves import UPDATE
from pipeline.ppo.normaliser import Normaliser
from pipeline.ppo.training import Training


def test_every_reward_term_has_a_curve_of_its_own(order, straight):
    assert [point["step"] for point in straight.curve] == [64 * (k + 1) for k in range(6)]
    for point in straight.curve:
        assert list(point["terms"]) == list(order.task.weights)
        assert point["reward"] == pytest.approx(sum(point["terms"].values()))
        assert point["terms"]["effort"] < 0 < point["terms"]["upright"]


def test_every_iteration_says_what_its_update_did_the_last_one_too(straight):
    for point in straight.curve:
        assert {"entropy", "kl", "clipped", "value_loss"} <= set(point["update"]) <= {*UPDATE}
        assert np.isfinite(list(point["update"].values())).all()
        gauss = 10 * (0.5 * np.log(2 * np.pi * np.e) + np.log(point["std"]))  # ten joints, nearly of one spread
        assert point["update"]["entropy"] == pytest.approx(gauss, abs=0.1)


def test_a_robot_that_is_paid_for_sparing_its_motors_comes_to_spare_them(order, tmp_path):
    lazy = order.task.model_copy(update={"weights": {"effort": -1.0}, "seconds": 0.6})
    ppo = order.ppo.model_copy(update={"steps": 15_000, "attempts": 64, "batch": 512, "epochs": 4, "reward_scale": 1.0,
                                       "learning_rate": 0.01})
    curve = Training(order.model_copy(update={"task": lazy, "ppo": ppo}), tmp_path).run().curve
    first, last = (np.mean([p["terms"]["effort"] for p in part]) for part in (curve[:5], curve[-5:]))
    assert first < last * 1.05 < 0


def test_the_normaliser_knows_mean_and_spread_however_the_rows_came():
    rows = np.random.default_rng(0).normal([3, -1, 5], [2, 0.5, 0], (1000, 3)).astype(np.float32)
    pieces = Normaliser(3)
    for part in np.array_split(rows, [1, 10, 700]):
        pieces.update(part)
    assert np.allclose(pieces.mean, rows.mean(axis=0), atol=1e-5)
    assert np.allclose(pieces.std, np.maximum(rows.std(axis=0), 0.01), rtol=1e-5)
    again = Normaliser(3)
    again.load(pieces.save())
    assert np.array_equal(again(rows), pieces(rows))
    assert np.abs(pieces(rows)[:, 2]).max() < 1e-3  # what never changes is not blown up
