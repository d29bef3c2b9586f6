"""Signals of deployed attempts: recorded at every tick, made of what the robot sensed, and no hand on the robot."""

import numpy as np
import pytest

from pipeline.lerobot_view.training_data import TrainingData
from pipeline.protocols import Observation
from pipeline.recording import read_episode
from pipeline.shadow.riders import Riders
from pipeline.signals.neighbours import Neighbours
from pipeline.signals.tick import NAMES
from schemas.recipe import LastingConfig
from stages.deploy import deploy

pytestmark = pytest.mark.xdist_group("stages")


@pytest.fixture(scope="module")
def neighbours(learnt):
    data = TrainingData.load(next((learnt.store / "versions").iterdir()))
    return Neighbours.among(data.state, data.environment)


@pytest.fixture(scope="module")
def watched_with(recipe, learnt, policy, tmp_path_factory, neighbours, software, seed, twin):
    """Lets the champion work, watched, with the other policy in its shadow."""

    def work(**harvest):
        changed = recipe.model_copy(update={"harvest": recipe.harvest.model_copy(update=harvest)})
        with Riders({learnt.other.id: learnt.store / learnt.other.checkpoint / "policy.onnx"}, patient=True) as riders:
            return deploy(policy(learnt.champion), learnt.champion.id, changed, seed=seed, twin=twin, generation=0,
                          folder=tmp_path_factory.mktemp("watched"), software=software, riders=riders,
                          neighbours=neighbours)

    return work


@pytest.fixture(scope="module")
def watched(watched_with):
    return watched_with()


def test_every_signal_is_recorded_at_every_tick(watched, learnt, neighbours):
    for recorded in watched.recorded:
        trace = read_episode(recorded.path)[1]
        assert tuple(trace.signals) == NAMES
        assert all(values.shape == (len(trace),) for values in trace.signals.values())
        seen = Observation(trace.state, trace.environment)
        assert trace.signals["distance"] == pytest.approx(neighbours.distance(seen), rel=1e-5)
        assert trace.signals["apart"].tobytes() == trace.shadows[learnt.other.id].disagreement.tobytes()
        assert np.isnan(trace.signals["warning"][0]) and np.isfinite(trace.signals["warning"][1:]).all()


def test_watching_changes_nothing_that_the_champion_does(watched, attempts, same_bits):
    for recorded, (episode, trace) in zip(watched.recorded, attempts, strict=True):
        found, seen = read_episode(recorded.path)
        assert found.outcome == episode.outcome
        assert all(same_bits(getattr(seen, n), getattr(trace, n)) for n in ("action", "state", "sim_state"))


def test_the_report_gets_curves_of_both_kinds(watched):
    assert tuple(watched.signals) == NAMES
    assert {kind for kinds in watched.signals.values() for kind in kinds} <= {"success", "failure"}


def test_a_lasting_disagreement_stops_attempts_earlier_where_a_recipe_asks_for_it(watched, watched_with):
    stopped = watched_with(disagreement=LastingConfig(apart=0.05, ticks=10))
    by_id = {r.episode.id: r.episode for r in watched.recorded}
    hit = [r.episode for r in stopped.recorded if r.episode.outcome.trigger == "disagreement"]
    assert hit
    for episode in hit:
        assert episode.outcome.family.startswith("disagreement-")
        assert episode.frames <= by_id[episode.id].frames
        trace = next(read_episode(r.path)[1] for r in stopped.recorded if r.episode.id == episode.id)
        assert (trace.signals["apart"][-10:] > 0.05).all()
    assert stopped.robot_s < watched.robot_s
