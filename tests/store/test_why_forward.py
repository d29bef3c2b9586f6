"""Forward from anything to what used it, and the groups in which it is told."""


import pytest

from pipeline.errors import StoreError
from pipeline.files import short_id
from pipeline.store import Store
from pipeline.store.graph import graph_of, in_order
from pipeline.store.lineage import render, why


@pytest.fixture
def lived(live, root):
    return live(root)


def used(store, id):
    return {(u.kind, *sorted(u.ids)) for u in why(store, id).used_by}


def test_a_demonstration_is_followed_to_everything_that_came_of_it(lived, root):
    with Store.open(root) as store:
        kinds = {kind for kind, *_ in used(store, lived.demo)}
        text = render(why(store, lived.demo, back=False))
        assert kinds == {"episode", "version", "policy", "verdict", "release", "hard_case"}
        (case,), after = store.hard_cases(), text.partition("used by:")[2]
        for chain in (["verdict", "release 1"],
                      ["attempt at work", f"hard case {case.id}", "correction", f"version {lived.later}"]):
            wanted = [f"version {lived.version}", f"policy {lived.policy}", *chain]
            assert [after.index(w) for w in wanted] == sorted(after.index(w) for w in wanted), "causes before effects"
        assert "parent" not in text


def test_a_variant_leads_back_to_where_it_begins_and_forward_from_there(lived, root):
    with Store.open(root) as store:
        (near,) = [e for e in store.episodes() if (e.transform or "").startswith("retarget near")]
        behind = {i for n in graph_of(store, "episode", near.id, forward=False).nodes for i in n.ids}
        assert {near.parent, lived.demo} <= behind
        assert any(near.id in ids for kind, *ids in used(store, lived.demo) if kind == "episode")


def test_every_kind_of_thing_is_explained_in_both_directions(lived, root):
    with Store.open(root) as store:
        (check,) = store.check_history(store.episode(lived.demo).blob)
        told = render(why(store, check.id))
        assert f"verdict: FAILED: gaps: {lived.canary.text}" in told and f"of: recording {lived.demo}" in told
        assert lived.demo in {i for n in graph_of(store, "checked", check.id).nodes for i in n.ids}
        (run,) = store.runs()
        assert ("policy", lived.policy) in used(store, run)
        assert why(store, store.episode(lived.demo).blob).id == lived.demo, "a recording is known by its hash, too"
        assert used(store, lived.policy) >= {("verdict", store.verdicts()[0].id)}
        assert why(store, lived.later).kind == "version" and used(store, lived.later) == set()


def test_a_consent_leads_to_all_that_rests_on_it(store, small):
    from datetime import date

    from schemas.consent import Consent
    store.add_consent(Consent(id="form-12", operator="ada", site="lab", purposes=("training",),
                              given=date(2026, 1, 1), expires=date(2027, 1, 1)))
    with store.lease(small.run) as lease, store.commit(lease) as tx:
        tx.add_run(small.info())
        driven = [small.episode(k, origin="teleop", consent="form-12") for k in range(3)]
        tx.add_episodes([*driven, small.variant(9, of=driven[0], consent="form-12")])
    told = why(store, "form-12")
    assert told.facts["operator"] == "ada at lab"
    assert [(u.title, len(u.ids)) for u in told.used_by] == [("3 drives by people", 3), ("variant, carried over", 1)]
    assert "consent" in {n.kind for n in graph_of(store, "episode", short_id("variant", 0, 9), forward=False).nodes}


def test_many_things_are_told_as_groups(store, small):
    policy = small.lap(store, demonstrations=200)
    graph = graph_of(store, "policy", policy.id)
    titles = [n.title for n in in_order(graph)]
    assert "200 demonstrations" in titles and "400 variants, carried over" in titles and len(titles) < 12
    assert titles.index("200 demonstrations") < titles.index(f"version {policy.dataset}") < titles.index(
        f"policy {policy.id}") < titles.index("attempt at work")


def test_what_nobody_used_says_nothing_of_users(store, small):
    small.lap(store)
    with store.lease(small.run) as lease, store.commit(lease) as tx:
        tx.add_episodes([small.episode(777)])
    assert "used by" not in render(why(store, small.episode(777).id))


def test_a_walk_asks_only_through_indexes(store, small):
    from json import dumps

    from pipeline.store.relations import BACK, FORWARD
    small.lap(store)
    for relations in (BACK, FORWARD):
        for kind, many in relations.items():
            for relation in many:
                plan = store.query(f"EXPLAIN QUERY PLAN {relation.sql}", (dumps(["x"]),))
                scans = [str(row[3]) for row in plan if str(row[3]).startswith("SCAN")]
                big = [s for s in scans if s.split()[1] in {"episode", "version_episode", "member", "checked"}]
                assert not big, f"{kind} to {relation.to}: {big}"


@pytest.mark.parametrize("wrong, message", [
    ("form-99", "not a valid id: 'form-99'"), ("f" * 64, "is not in the store"), ("f" * 12, "is not in the store")])
def test_what_is_not_there_is_said(store, small, wrong, message):
    small.lap(store)
    with pytest.raises(StoreError, match=message):
        why(store, wrong)
