"""A batch that hurts is left out of later versions, its candidate is not released, and it is listed with the reason."""

import json

import pytest

from flows.run.learning import released
from flows.run.worth import indicated, judged_batch
from flows.run.worth_door import held_back
from pipeline.errors import GateError
from schemas.worth import BatchWorth, WorthPart
from stages.worth import batch_id


def quiet(done, total):
    """Nobody watches."""


@pytest.fixture
def verdict_on(steps):
    """Writes down a verdict on some episodes of lap 1's version."""
    version = steps.material.version(1)

    def write(episodes, decision, number=1):
        sign = {"HURTS": -1, "HELPS": 1}[decision]
        solved, failed = (90,) * 8, (100,) * 8
        part = WorthPart(name="all", scenes=200, with_batch=solved, without=failed, difference=sign * 0.05, low=-0.08,
                         high=-0.02, p=0.0002, p_holm=0.0002)
        worth = BatchWorth(id=f"{number:016x}", version=version.id, batch=batch_id(episodes), says="three corrections",
                           episodes=tuple(episodes), decision=decision, parts=(part,), seeds_with=tuple(range(8)),
                           reason="-5.0 points [-8.0 -2.0]", seeds_without=tuple(range(8, 16)))
        steps.store.add_worth(worth)
        return worth

    return write


@pytest.fixture
def corrections(steps):
    return [e.id for e in steps.store.episodes(steps.material.version(1).episodes) if e.origin == "corrected"]


def next_lap(steps):
    steps.deploy(1, quiet)
    steps.harvest(1, quiet)
    steps.augment(2, quiet)
    return steps.build(2, quiet)


def test_what_hurts_is_left_out_of_the_next_version_and_listed_with_the_reason(steps, verdict_on, corrections):
    worth = verdict_on(corrections, "HURTS")
    says = next_lap(steps).says
    assert f"3 left out, they hurt: three corrections ({worth.id}) -5.0 points" in says
    assert not set(corrections) & set(steps.material.version(2).episodes)
    assert set(steps.material.version(2).episodes) & set(steps.material.version(1).episodes)


def test_a_later_verdict_on_the_same_batch_frees_it(steps, verdict_on, corrections):
    verdict_on(corrections, "HURTS", 1)
    episodes = steps.store.episodes(corrections)
    assert steps.material.usable(episodes) == []
    verdict_on(list(reversed(corrections)), "HELPS", 2)
    assert steps.material.usable(episodes) == episodes


def test_variants_of_what_hurts_are_left_out_with_it(steps, verdict_on):
    first = steps.store.episodes(steps.material.ids(0, "collect"))
    variants = [e for e in steps.store.episodes(steps.material.version(1).episodes) if e.parent == first[0].id]
    verdict_on([first[0].id], "HURTS")
    out = steps.material.worths().against([*first, *variants])
    assert variants and set(out) == {first[0].id, *(v.id for v in variants)}


def test_a_candidate_that_learnt_from_it_is_not_released_and_the_champion_stays(steps, verdict_on, corrections):
    gate = steps.store.verdict(steps.material.ids(1, "gate")[0]).model_copy(update={"decision": "PASS"})
    assert held_back(steps, gate) is None
    verdict_on(corrections, "HURTS")
    held = held_back(steps, gate)
    assert held.ids == (steps.store.champion(steps.run).policy,) and held.numbers["released"] is False
    assert "learnt from a batch that hurts" in held.says and "the champion stays" in held.says


def test_without_a_champion_nothing_can_stay_and_the_error_says_what_to_do(steps, verdict_on, monkeypatch):
    verdict_on([steps.material.ids(0, "collect")[0]], "HURTS")
    monkeypatch.setattr(steps.store, "champion", lambda run: None)
    with pytest.raises(GateError, match=r"learnt from a batch that hurts(.|\n)*mend: derive a version without it"):
        released(steps, 0)


def test_why_tells_of_a_version_and_an_episode_that_it_hurts(steps, verdict_on, corrections, hardcase):
    worth = verdict_on(corrections, "HURTS")
    for id in (corrections[0], steps.material.version(1).id):
        assert f"{worth.id} HURTS: three corrections, -5.0 points" in hardcase("why", id)[1]
    assert "HURTS" in hardcase("why", worth.id)[1]


def test_one_extra_training_gives_an_indication_and_decides_nothing(steps):
    found = indicated(steps, 1, scenes=20)
    assert found.decision == "INCONCLUSIVE" and "1 seed, indicative" in found.reason
    assert len(found.seeds_with) == len(found.seeds_without) == 1
    assert found.seeds_with[0] == steps.store.policy(steps.candidate(1)).seed
    assert steps.store.worths() == []
    assert indicated(steps, 0, scenes=20) is None


def test_the_list_shows_what_is_kept_out_and_why(steps, verdict_on, corrections, hardcase):
    assert "no batch was judged yet" in hardcase("worth", "--list")[1]
    worth = verdict_on(corrections, "HURTS")
    code, out, _ = hardcase("worth", "--list")
    assert code == 0 and worth.id in out and "HURTS" in out and "-5.0" in out
    assert BatchWorth.model_validate(json.loads(hardcase("worth", "--list", "--json")[1])[0]) == worth


def test_a_stage_of_the_loop_judges_what_a_lap_added_and_keeps_the_verdicts(steps):
    seen = []
    made = judged_batch(steps, 1, lambda done, total: seen.append((done, total)), seeds=1, scenes=20)
    assert made.ids == tuple(w.id for w in steps.store.worths()) and len(made.ids) == 2
    assert made.says.count("INCONCLUSIVE") == 2 and "the recordings in what lap 1 added" in made.says
    assert seen[-1] == (4, 4) and seen == sorted(seen)
    assert judged_batch(steps, 0, quiet) is None
