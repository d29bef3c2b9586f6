"""How many disagreements are judged a minute, beside branches played one after the other.

Run: pytest -s tests/bench_counterfactual.py

A small loop is turned first: two trained policies, 60 recorded attempts of one on a twin. Judged are the lasting
disagreements of the other with it, 16 draws of each policy, verification by replay included. CPU seconds of this
process on one thread; two cores judge twice as many by the clock when nobody else uses them.
"""

import time

import numpy as np
import pytest

from flows.run.judging import restorable
from flows.run.steps import open_run
from pipeline.counterfactual.branches import branch
from pipeline.counterfactual.judging import Named, judge
from pipeline.counterfactual.moment import Lab, moment_of
from pipeline.counterfactual.restore import faults
from pipeline.counterfactual.ride import ride
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.counterfactual import JudgeConfig
from schemas.recipe import AugmentConfig, CollectConfig, DeployConfig, ExamConfig, GateConfig, Recipe, TrainConfig

TWIN = 4
ASKED = 100
"""Disagreements a minute on two cores."""
COMPARED = 6
"""Disagreements of which one pair of branches is also played by itself."""
RECIPE = Recipe(
    name="bench", generations=1, threads=1, collect=CollectConfig(demonstrations=20),
    augment=AugmentConfig(replays=40, retargets=40), train=TrainConfig(steps=500, checkpoint_every=500),
    gate=GateConfig(looks=(4,), bootstrap_success=0.0), deploy=DeployConfig(episodes=60, shadow=False),
    exam=ExamConfig(common=1, rare=1))


@pytest.fixture(scope="module")
def worked(tmp_path_factory):
    """Attempts of the champion of generation 0, it, and the candidate of generation 1."""
    with open_run(tmp_path_factory.mktemp("bench"), RECIPE, seed=0, twin=TWIN, control=False) as steps:
        for generation in range(2):
            for stage in ("collect", "augment", "build", "train", "gate", "release", "exam", "deploy", "harvest"):
                if (generation, stage) == (1, "gate"):
                    break
                if generation == 0 or stage != "collect":
                    getattr(steps, stage)(generation, lambda done, total: None)
        first, second = (steps.candidate(g) for g in range(2))
        return (steps.material.deployed_attempts(0), *(Named(p, restorable(steps, p)) for p in (first, second)))


def test_disagreements_judged_a_minute(worked):
    attempts, champion, candidate = worked
    robot = draw_twin(TWIN)
    lab, config, triggers = Lab(twin_setup(robot, "arm", "table"), 1), JudgeConfig(), RECIPE.harvest
    start = time.process_time()
    found = judge(attempts, champion, candidate, robot.draws, lab, config, triggers)
    whole = time.process_time() - start
    n = len(found.judgements)
    assert n >= COMPARED and not found.refusals

    rides = [ride(p.policy, [t for _, t in attempts]) for p in (champion, candidate)]
    moments = [moment_of(e, t, w, robot.draws, a, b) for (e, t), w, a, b
               in zip(attempts, found.windows, *rides, strict=True) if w is not None]
    start = time.process_time()
    assert faults(moments, lab) == [None] * n
    proof = time.process_time() - start
    start = time.process_time()
    for moment in moments[::max(1, n // COMPARED)][:COMPARED]:
        branch([moment], champion.policy, candidate.policy, lab, config.model_copy(update={"draws": 1}), triggers)
    pair = (time.process_time() - start) / COMPARED
    rate, batched = 60 * n / whole, (whole - proof) / n / config.draws
    print(f"\n{n} disagreements of {len(attempts)} attempts, 2 x {config.draws} branches each: {whole:.1f} CPU s, "
          f"{rate:.0f} a CPU minute, {2 * rate:.0f} a minute on 2 cores (asked {ASKED})")
    print(f"a pair of branches: {1e3 * batched:.0f} CPU ms side by side, {1e3 * pair:.0f} ms pair by pair, "
          f"{pair / batched:.1f} times as much")
    print(f"of the whole, restoring and proving by replay: {proof:.1f} CPU s")
    print(f"mean success champion {np.mean([j.champion.success.rate for j in found.judgements]):.2f}, "
          f"candidate {np.mean([j.candidate.success.rate for j in found.judgements]):.2f}")
    assert 2 * rate >= ASKED
