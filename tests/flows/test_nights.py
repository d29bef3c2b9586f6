"""A lasting loop, night by night: the ledger, the choice among trainings, the anchor, and the way back to it."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.run.night_by_hand import ledger, ledger_table, nightly_order, run_night
from flows.run.nights import books
from flows.run.opening import open_order
from flows.service.estimate import night_steps
from pipeline.errors import GateError
from pipeline.store import Store
from schemas.night import Account, Night

pytestmark = pytest.mark.xdist_group("lerobot")

EAGER = """
name: eager-nights
generations: 9
threads: 1
collect: {demonstrations: 4}
augment: {replays: 0, retargets: 0, per_correction: 2}
train: {chunk: 8, steps: 100, batch: 64, checkpoint_every: 100}
gate:
  looks: [12]
  bootstrap_success: 0.0
  margin: 0.9
  seeds: 2
  selection: 12
  nightly: {false_promotions: 0.6, nights: 30, most_stake: 30, anchor_every: 1, anchor_share: 0.4, batch: 12,
            most_scenes: 48, regression_seeds: 3, regression_lost: 1}
deploy: {episodes: 12, rare_share: 0.25, shadow: false}
harvest: {corrections: 6, worth_seeds: 1}
exam: {common: 4, rare: 2}
"""
"""A gate that nearly anything passes: what is tested here is what nights do with verdicts."""


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> Iterator[Path]:
    """Two nights, on days 100 and 129: the last of a budget year that began with the first test."""
    folder = tmp_path_factory.mktemp("nights")
    (folder / "eager.yaml").write_text(EAGER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HARDCASE_STORE", str(folder / "store"))
        for day in (100, 129):
            run_night(recipe=str(folder / "eager.yaml"), seed=0, twin=1, day=day)
        yield folder


@pytest.fixture
def store(turned) -> Iterator[Store]:
    with Store.open(turned / "store") as opened:
        yield opened


def rows(turned: Path) -> list[Night]:
    return ledger(recipe=str(turned / "eager.yaml"), seed=0, twin=1)


def test_the_first_night_needs_no_budget_and_the_second_is_in_the_ledger(turned, store):
    (row,) = rows(turned)
    verdict = store.verdict(row.verdict)
    assert (row.generation, row.day, row.since) == (1, 129, 129)
    assert row.candidates.before == pytest.approx(0.36)
    assert row.candidates.stake == pytest.approx(0.36 / 30) == verdict.tonight.stake
    assert row.candidates.after == pytest.approx(0.36 - row.candidates.stake + verdict.tonight.given_back)
    assert row.promoted == (verdict.decision == "PASS")
    assert store.verdicts(run=row.run)[0].decision == "BOOTSTRAP"


def test_every_training_is_kept_and_the_best_on_scenes_of_their_own_was_judged(turned, store):
    (row,) = rows(turned)
    verdict = store.verdict(row.verdict)
    choice = verdict.tonight.selection
    trained = store.policies(run=row.run, generation=1)
    assert {p.id for p in trained} == set(choice.solved) and len({p.seed for p in trained}) == 2
    assert verdict.candidate == choice.chosen == max(choice.solved, key=choice.solved.get)
    assert choice.scenes == 12


def test_what_a_night_added_is_judged_by_retraining_before_the_release_and_the_verdict_kept(turned, store):
    (row,) = rows(turned)
    step = store.step(row.run, 1, "worth")
    found = {w.id: w for w in store.worths()}
    assert step.outputs["ids"] and set(step.outputs["ids"]) <= set(found)
    assert all(found[id].decision == "INCONCLUSIVE" and found[id].seeds_with for id in step.outputs["ids"])
    assert store.step(row.run, 1, "judge") is not None


def test_a_night_that_is_asked_again_turns_the_next_lap_and_the_same_day_shares_its_money(turned):
    order = nightly_order(str(turned / "eager.yaml"), 0, 1)
    with open_order(order, turned / "store") as steps:
        assert steps.tonight() == 2
        first = [(s.stage, s.generation) for s in night_steps(2, order.recipe)][:3]
        assert first == [("deploy", 1), ("harvest", 1), ("augment", 2)]


def test_a_lost_test_against_the_anchor_puts_it_back_and_keeps_everything(turned, store):
    """The verdict is made up, a truly worse champion being too rare to wait for; what follows is the real thing."""
    (row,) = rows(turned)
    order = nightly_order(str(turned / "eager.yaml"), 0, 1)
    with open_order(order, turned / "store") as steps:
        for step in night_steps(2, order.recipe):
            if step.stage == "gate":
                break
            getattr(steps, step.stage)(step.generation, lambda done, total: None)
        first, candidate = steps.store.releases(row.run)[0].policy, steps.candidate(2)
        known = steps.store.verdict(row.verdict)
        champion = steps.store.champion(row.run).policy
        won = known.model_copy(update={"id": "1" * 16, "candidate": candidate, "champion": champion, "generation": 2,
                                       "decision": "PASS"})
        lost = won.model_copy(update={"id": "2" * 16, "champion": first, "decision": "FAIL"})
        account = Account(before=0.1, after=0.1)
        night = Night(run=row.run, generation=2, day=130, since=129, candidates=account, anchors=account,
                      verdict=won.id, promoted=True, anchor=first, promotions=0, anchor_verdict=lost.id,
                      roll_back_to=first)
        with steps.store.commit(steps.lease, row.run) as tx:
            tx.add_verdict(lost)
            tx.add_verdict(won)
            tx.add_night(night)
            tx.finish_step(2, "gate", outputs={"ids": [won.id, lost.id], "says": "PASS"})
        said = steps.release(2, lambda done, total: None).says
        history = steps.store.releases(row.run)
    assert f"release {history[-2].number}, which lost against the anchor; back to it: release" in said
    assert [(r.policy, r.kind) for r in history[-2:]] == [(candidate, "promotion"), (first, "rollback")]
    assert history[-1].verdict == lost.id and store.champion(row.run).policy == first


def test_the_ledger_prints_for_people_and_machines(turned, hardcase):
    words = ("nights", "--recipe", str(turned / "eager.yaml"), "--twin", "1")
    told = hardcase(*words, "--json", HARDCASE_STORE=str(turned / "store"))
    assert told.returncode == 0 and json.loads(told.stdout)[0]["day"] == 129
    shown = ledger_table(rows(turned)).splitlines()
    assert shown[0].split()[:4] == ["night", "day", "stake", "left"] and shown[1].split()[:2] == ["1", "129"]


def test_a_recipe_without_a_nightly_gate_is_refused_in_one_line(hardcase):
    refused = hardcase("night", "--recipe", "smoke")
    assert refused.returncode == 2 and "mend: add `nightly: {}` below `gate:`" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 3


def test_a_day_before_the_budget_year_is_refused_with_the_mend(turned):
    order = nightly_order(str(turned / "eager.yaml"), 0, 1)
    with open_order(order, turned / "store") as steps:
        steps.day = 99
        with pytest.raises(GateError, match="mend: set the clock right"):
            books(steps, 3, steps.store.champion(steps.run).policy, steps.recipe.gate.nightly)
