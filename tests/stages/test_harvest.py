import numpy as np
import pytest

from pipeline.recording import read_episode
from pipeline.simulation.world import CONTROLLER_WIDTH
from pipeline.triggers import stratum_of
from pipeline.twin.operator import GROSS_M, aim_error
from pipeline.twin.twin import draw_twin, twin_world
from schemas.recipe import HarvestConfig
from stages.harvest import demonstrate

pytestmark = pytest.mark.xdist_group("stages")


@pytest.fixture(scope="module")
def oracle(harvest_with):
    return harvest_with(oracle=True, rewind_ticks=10)


def test_every_flagged_attempt_becomes_a_hard_case(attempts, harvested):
    flagged = {e.id: (e, t) for e, t in attempts if e.outcome.label == "failure"}
    assert {c.episode for c in harvested.cases} == set(flagged)
    assert len({c.id for c in harvested.cases}) == len(harvested.cases)
    for case in harvested.cases:
        episode, trace = flagged[case.episode]
        assert (case.trigger, case.family, case.tick) == (
            episode.outcome.trigger, episode.outcome.family, episode.outcome.tick)
        assert case.stratum == stratum_of(trace.environment[0])


def test_corrections_are_shared_out_between_the_kinds_of_start(harvested, recipe):
    chosen, met = [c.stratum for c in harvested.chosen], [c.stratum for c in harvested.cases]
    assert len(chosen) == min(recipe.harvest.corrections, len(met))
    for name in set(met):
        assert chosen.count(name) >= min(met.count(name), len(chosen) // len(set(met)))


def test_a_corrected_case_names_its_correction(harvested):
    made = {r.episode.parent: r.episode for r in harvested.recorded}
    for case in harvested.cases:
        correction = made.get(case.episode)
        assert case.correction == (correction.id if correction else None)
        assert case.corrected is (correction is not None and correction.outcome.label == "success")


def test_the_operator_takes_over_exactly_where_the_trigger_fired(attempts, corrections, twin, same_bits):
    by_id = {e.id: (e, t) for e, t in attempts}
    assert corrections
    for episode, trace in corrections:
        parent, before = by_id[episode.parent]
        n, ids = len(before), np.arange(1)
        for name in ("sim_state", "action", "state", "environment", "joint_action"):
            assert same_bits(getattr(trace, name)[:n], getattr(before, name))
        world = twin_world(draw_twin(twin), [parent.scene], threads=1)
        world.load(ids, before.sim_state[[-1]], before.controller[[-1], :CONTROLLER_WIDTH])
        world.act(before.action[[-1]], ids)
        sim, memory = world.save(ids)
        assert same_bits(sim[0], trace.sim_state[n])
        # the clock of the attempt starts over (third from the end); the rest of the controller stands as it stood
        taken = trace.controller[n, :CONTROLLER_WIDTH]
        assert same_bits(np.delete(memory[0], -3), np.delete(taken, -3))
        assert taken[-3] == 0


def test_segments_tell_the_policys_part_from_the_persons_and_leave_the_delay_out(attempts, corrections, recipe):
    by_id = {e.id: t for e, t in attempts}
    for episode, trace in corrections:
        n, delay = len(by_id[episode.parent]), recipe.harvest.operator_delay_ticks
        assert [(s.kind, s.start, s.stop) for s in episode.segments] == [
            ("autonomous", 0, n + delay), ("intervention", n + delay, len(trace))]
        assert (episode.origin, episode.transform, episode.outcome.judged_by) == ("corrected", "correction", "operator")
        waiting = trace.action[n:n + delay]
        assert (waiting[:, :4] == 0).all()
        assert (waiting[:, 4] == trace.state[n:n + delay, 15]).all()
        assert [(e.name, e.tick) for e in trace.events][-1] == ("intervention", n + delay)


def test_a_corrections_outcome_keeps_what_had_gone_wrong(attempts, corrections):
    by_id = {e.id: e for e, _ in attempts}
    for episode, _ in corrections:
        was = by_id[episode.parent].outcome
        assert (episode.outcome.trigger, episode.outcome.family, episode.outcome.tick) == (
            was.trigger, was.family, was.tick)


def test_robot_time_is_the_time_that_people_drove(harvested):
    driven = sum(s.stop - s.start for r in harvested.recorded for s in r.episode.segments if s.kind == "intervention")
    assert harvested.robot_s == pytest.approx(driven / 20)


def test_a_tenth_of_the_corrections_go_grossly_wrong():
    config = HarvestConfig()
    errors = np.array([aim_error(seed, config) for seed in range(5000)])
    far = np.linalg.norm(errors, axis=1)
    gross = far >= GROSS_M[0]
    assert gross.mean() == pytest.approx(0.1, abs=0.015)
    assert far.max() <= GROSS_M[1]
    assert errors[~gross].std() == pytest.approx(config.operator_aim_sd_m, rel=0.05)


def test_gross_errors_cost_corrections(harvest_with):
    never, always = (sum(c.corrected for c in harvest_with(operator_gross_error=share).cases) for share in (0.0, 1.0))
    assert always < never


def test_the_oracle_rewinds_and_does_not_wait(attempts, oracle):
    by_id = {e.id: t for e, t in attempts}
    assert oracle.recorded
    for recorded in oracle.recorded:
        episode, trace = read_episode(recorded.path)
        at = max(1, len(by_id[episode.parent]) - 10)
        assert episode.origin == "oracle"
        assert [(s.kind, s.start, s.stop) for s in episode.segments] == [
            ("autonomous", 0, at), ("intervention", at, len(trace))]
        assert np.array_equal(trace.state[:at], by_id[episode.parent].state[:at])


def test_the_same_harvest_gives_the_same_bytes(harvest_with, harvested, bytes_of):
    again = harvest_with()
    assert again.cases == harvested.cases
    assert bytes_of(again.recorded[0].path.parent) == bytes_of(harvested.recorded[0].path.parent)


def test_nothing_to_correct_leaves_nothing_behind(harvest_with, attempts):
    none = harvest_with(corrections=0)
    assert len(none.cases) == sum(e.outcome.label == "failure" for e, _ in attempts)
    assert (none.recorded, none.robot_s) == ((), 0.0)
    assert not any(c.corrected or c.correction for c in none.cases)


def test_a_control_arms_demonstrations_are_the_same_persons_from_the_start(attempts, recipe, twin, software, tmp_path):
    scenes = [e.scene for e, _ in attempts][:3]
    made = demonstrate(scenes, recipe, twin=twin, generation=0, folder=tmp_path, software=software)
    for recorded, scene in zip(made, scenes, strict=True):
        episode, trace = read_episode(recorded.path)
        assert (episode.origin, episode.scene, episode.parent) == ("scripted", scene, None)
        assert [(s.kind, s.start, s.stop) for s in episode.segments] == [("demonstration", 0, len(trace))]
        assert episode.outcome.judged_by == "operator"
