import numpy as np
import pytest

from pipeline.protocols import Observation
from pipeline.recording import read_episode
from pipeline.simulation.tasks import load_task
from pipeline.simulation.world import CONTROLLER_WIDTH
from pipeline.triggers import TRIGGERS, family, fired
from pipeline.twin.twin import draw_twin, twin_world
from stages.deploy import deploy_scenes, senses_of

pytestmark = pytest.mark.xdist_group("stages")


@pytest.fixture(scope="module")
def alone(deploy_with):
    """The champion at work with nobody in its shadow."""
    return deploy_with()


def test_every_attempt_is_recorded_and_counts_as_robot_time(deployed, attempts, recipe, learnt, seed, twin):
    scenes = deploy_scenes(recipe, seed=seed, twin=twin, generation=0)
    assert [e.scene for e, _ in attempts] == scenes
    assert len(attempts) == recipe.deploy.episodes
    for episode, trace in attempts:
        assert (episode.origin, episode.policy, episode.frames) == ("deployed", learnt.champion.id, len(trace))
        assert [(s.kind, s.actor) for s in episode.segments] == [("autonomous", learnt.champion.id)]
    assert deployed.robot_s == pytest.approx(sum(e.duration_s for e, _ in attempts))


def test_the_starts_hold_exactly_the_rare_share(recipe, seed, twin):
    rare = load_task(recipe.task).rare
    for generation in range(3):
        scenes = deploy_scenes(recipe, seed=seed, twin=twin, generation=generation)
        assert sum(s.stratum in rare for s in scenes) == recipe.deploy.episodes * recipe.deploy.rare_share


def test_outcomes_follow_from_what_was_sensed_and_from_nothing_else(attempts, recipe):
    one = np.arange(1)
    for episode, trace in attempts:
        senses = senses_of(load_task(recipe.task), 1, recipe.harvest)
        for tick in range(len(trace)):
            senses.update(Observation(trace.state[[tick]], trace.environment[[tick]]), one)
            believed, which = bool(senses.succeeded(one)[0]), int(fired(senses, one)[0])
            assert (believed or which >= 0) is (tick == len(trace) - 1)
        outcome = episode.outcome
        assert outcome.judged_by == "sensors"
        if believed:
            assert (outcome.label, outcome.trigger, outcome.family, outcome.tick) == ("success", None, None, None)
        else:
            name = list(TRIGGERS)[which]
            assert (outcome.label, outcome.trigger, outcome.tick) == ("failure", name, len(trace) - 1)
            assert outcome.family == family(name, senses.phase(0))
            assert [e.name for e in trace.events] == ["trigger"]


def test_both_outcomes_occur_and_truth_is_kept_apart(deployed, attempts):
    labels = {e.outcome.label for e, _ in attempts}
    assert labels == {"success", "failure"}
    assert deployed.truth.shape == (len(attempts),)


def test_a_rider_changes_nothing_that_the_champion_does(attempts, alone, same_bits):
    for recorded, (episode, ridden) in zip(alone.recorded, attempts, strict=True):
        single, trace = read_episode(recorded.path)
        assert trace.shadows == {}
        assert single == episode.model_copy(update={"blob": single.blob})
        for name in ("action", "joint_action", "state", "environment", "sim_state", "controller"):
            assert same_bits(getattr(trace, name), getattr(ridden, name))
    assert np.isnan(alone.disagreement).all()


def test_the_riders_disagreement_is_recorded_every_tick(deployed, attempts, learnt):
    for (_, trace), mean in zip(attempts, deployed.disagreement, strict=True):
        assert list(trace.shadows) == [learnt.other.id]
        shadow = trace.shadows[learnt.other.id]
        assert shadow.disagreement.shape == (len(trace),)
        assert shadow.joint_commands.shape == (len(trace), 7)
        assert np.isfinite(shadow.disagreement).all() and (shadow.disagreement > 0).all()
        assert shadow.disagreement.mean() == pytest.approx(mean)


def test_a_policy_in_its_own_shadow_agrees_to_the_bit(deploy_with, learnt):
    deployed = deploy_with(learnt.champion)
    assert (deployed.disagreement == 0).all()
    _, trace = read_episode(deployed.recorded[0].path)
    shadow = trace.shadows[learnt.champion.id]
    assert np.array_equal(shadow.joint_commands, trace.joint_action)


def test_a_deployed_attempt_is_restored_with_its_policys_memory_and_goes_on_to_the_bit(
    attempts, learnt, policy, same_bits, twin
):
    episode, trace = max(attempts, key=lambda attempt: len(attempt[1]))
    world, champion = twin_world(draw_twin(twin), [episode.scene], threads=1), policy(learnt.champion)
    ids, k = np.arange(1), len(trace) // 2
    champion.reset(1)
    champion.restore(ids, trace.controller[[k - 1], CONTROLLER_WIDTH:])
    world.load(ids, trace.sim_state[[k]], trace.controller[[k], :CONTROLLER_WIDTH])
    for tick in range(k, len(trace)):
        seen = world.observe(ids)
        assert same_bits(seen.environment[0], trace.environment[tick])
        action = champion.act(seen, ids)
        assert same_bits(action[0], trace.action[tick])
        world.act(action, ids)
    assert same_bits(world.sent(ids)[0], trace.joint_action[-1])


def test_the_same_deployment_gives_the_same_bytes(deploy_with, alone, bytes_of):
    again = deploy_with()
    assert bytes_of(again.recorded[0].path.parent) == bytes_of(alone.recorded[0].path.parent)
