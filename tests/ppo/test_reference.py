"""The reference: ours and SB3's DummyVecEnv over Gymnasium tell SB3 the same bits, so they train the same bits."""

import json

import numpy as np
import pytest

from flows.studies.reference import folder_of, run_reference_study
from pipeline.errors import PolicyError
from pipeline.policies.resuming import newest
from pipeline.ppo.reference import PUBLISHED, ZOO, ReferenceOrder
from pipeline.ppo.reference_envs import ARMS
from pipeline.ppo.reference_training import ReferenceTraining

SMALL = {"ticks": 32, "steps": 22 * 32, "epochs": 2, "hidden": (8, 8), "learning_rate": 1e-3}


class CutOffError(Exception):
    pass


def order_of(arm, task="Hopper-v5", **given):
    return ReferenceOrder(task=task, arm=arm, ppo=ZOO[task].model_copy(update=SMALL | given), seed=3)


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    return {arm: ReferenceTraining(order_of(arm), tmp_path_factory.mktemp(arm)).run() for arm in ARMS}


@pytest.mark.parametrize("task", ZOO)
def test_both_tell_sb3_the_same(task):
    ours, dummy = (make(task, 2) for make in ARMS.values())
    assert (ours.observation_space, ours.action_space) == (dummy.observation_space, dummy.action_space)
    for env in (ours, dummy):
        env.seed(11)
    assert np.array_equal(ours.reset(), dummy.reset())
    rng, ended = np.random.default_rng(0), 0
    for _ in range(1010):
        action = rng.uniform(-1, 1, (2, *ours.action_space.shape)).astype(np.float32)
        mine, theirs = ours.step(action), dummy.step(action)
        for one, other in zip(mine[:3], theirs[:3], strict=True):
            assert one.dtype == other.dtype
            assert np.array_equal(one, other)
        for one, other in zip(mine[3], theirs[3], strict=True):
            assert one["TimeLimit.truncated"] == other["TimeLimit.truncated"]
            assert ("episode" in one) == ("episode" in other)
            if "episode" in one:
                ended += 1
                assert np.array_equal(one["terminal_observation"], other["terminal_observation"])
                assert one["episode"]["l"] == other["episode"]["l"]
                assert one["episode"]["r"] == pytest.approx(other["episode"]["r"], abs=1e-5)  # theirs is rounded
    assert ended >= 2


def test_both_train_the_same_weights(straight):
    ours, dummy = straight["ours"], straight["dummy"]
    assert ours.digest == dummy.digest
    assert ours.steps == dummy.steps == SMALL["steps"]
    assert len(ours.curve) == 1
    assert np.allclose(ours.curve, dummy.curve)
    fresh = ReferenceTraining(order_of("ours", steps=32), ours.folder / "fresh").run()
    assert fresh.digest != ours.digest


@pytest.mark.parametrize("arm", ARMS)
def test_a_training_that_was_cut_off_ends_with_the_same_bits(arm, straight, tmp_path):
    def cut(point):
        raise CutOffError

    with pytest.raises(CutOffError):
        ReferenceTraining(order_of(arm), tmp_path).run(cut, save_every=7)  # the first point is at iteration 20
    np.random.seed(99)  # noqa: NPY002 a new process would have another state, too
    resumed = ReferenceTraining(order_of(arm), tmp_path)
    assert resumed.steps == 14 * 32
    resumed.run()
    assert resumed.digest == straight[arm].digest
    assert resumed.curve == straight[arm].curve


def test_judging_changes_nothing_and_gives_the_same_again(straight):
    training = straight["ours"]
    before = training.digest
    (returns, lengths), again = training.evaluate(5, seed=1), training.evaluate(5, seed=1)
    assert np.array_equal(returns, again[0])
    assert not np.array_equal(returns, training.evaluate(5, seed=2)[0])
    assert ((lengths > 0) & (lengths <= 1000)).all()
    assert training.digest == before


def test_a_checkpoint_of_another_training_is_refused(straight):
    with pytest.raises(PolicyError, match="another training") as refused:
        ReferenceTraining(order_of("ours", clip=0.3), straight["ours"].folder)
    assert "mend: give another folder" in str(refused.value)


def test_the_study_trains_what_is_missing_and_tells_of_what_is_finished(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path))
    asked = {"steps": 512, "episodes": 2, "json": tmp_path / "found.json"}
    found = run_reference_study(seeds=1, train=True, **asked)
    assert json.loads((tmp_path / "found.json").read_bytes()) == found
    assert [(run["task"], run["arm"]) for run in found["runs"]] == [(task, arm) for arm in ARMS for task in ZOO]
    for task, pooled in found["pooled"].items():
        assert pooled["equal"] == pooled["both"] == [100]
        ours = pooled["arms"]["ours"]
        assert ours["low"] <= ours["iqm"] <= ours["high"]
        assert ours["share"] == pytest.approx(ours["mean"] / PUBLISHED[task])
    capsys.readouterr()

    last = newest(folder_of(ReferenceOrder.model_validate(found["runs"][0]["order"])))
    written = last.stat().st_mtime_ns
    told = run_reference_study(seeds=2, train=False, **asked)
    assert told["runs"] == found["runs"]
    assert told["missing"] == [f"{task}-{arm}-101" for arm in ARMS for task in ZOO]
    assert "not finished: Hopper-v5-ours-101" in capsys.readouterr().err.replace("\n", " ")
    assert last.stat().st_mtime_ns == written
