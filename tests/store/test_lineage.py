"""From any id back to what caused it."""

import json

import pytest

from pipeline.errors import StoreError
from pipeline.files import sha256
from pipeline.store.lineage import render, to_json, why


def test_a_policy_is_walked_back_to_its_recordings(store, small):
    policy = small.lap(store)
    text = render(why(store, policy.id, full=True))
    demos = store.episodes(origin="scripted")
    for wanted in [
        policy.dataset,
        policy.config,
        policy.code,
        small.run,
        "recipe: smoke",
        "commit abc1234",
        "mujoco 4.0.0",
        "draws: friction 0.4\n",
        "number 1",
        "BOOTSTRAP",
        *(e.blob for e in demos),
        *(e.id for e in store.episodes(origin="retargeted")),
    ]:
        assert wanted in text
    for demo in demos:
        assert store.blob(demo.blob).is_file()


def test_the_summary_counts_instead_of_listing(store, small):
    policy = small.lap(store, demonstrations=80)
    text = render(why(store, policy.id))
    assert "episodes: 160, 1600 frames" in text
    assert "parents: 80:" in text and "and 77 more" in text
    assert "draws: friction 1.4 to 2.99\n" in text
    assert f"step: train of generation 0, code {sha256(b'code')}" in text
    assert len(text.splitlines()) < 60
    assert len(render(why(store, policy.id, full=True)).splitlines()) > 240 * 5


def test_eight_digits_are_enough(store, small):
    policy = small.lap(store)
    assert why(store, policy.id[:8]) == why(store, policy.id)


def test_an_episode_tells_who_learned_from_it(store, small):
    policy = small.lap(store)
    variant = store.episodes(origin="retargeted")[0]
    told = why(store, variant.id)
    assert told.facts["seen by policies"] == policy.id
    assert told.facts["in versions"] == policy.dataset
    (parent,) = [c for c in told.children if c.role == "parent"]
    assert parent.facts["recording"] == store.episode(variant.parent).blob


def test_hard_case_verdict_version_and_run_are_explained(store, small):
    policy = small.lap(store)
    (case,) = store.hard_cases()
    text = render(why(store, case.id))
    assert "stall at tick 7" in text and f"policy: {policy.id}" in text
    assert "candidate: policy " + policy.id in render(why(store, small.verdict(policy).id))
    assert "group scripted" in render(why(store, policy.dataset))
    assert "hardcase loop --recipe smoke" in render(why(store, small.run))


def test_a_resumed_run_shows_every_call(store, small):
    small.lap(store)
    with store.lease(small.run) as lease, store.commit(lease) as tx:
        tx.add_run(small.info(command="hardcase loop --resume", versions={"mujoco": "4.0.1"}))
    text = render(why(store, small.run))
    assert "mujoco 4.0.0" in text and "mujoco 4.0.1" in text


def test_json_says_the_same(store, small):
    policy = small.lap(store)
    told = json.loads(to_json(why(store, policy.id)))
    assert (told["kind"], told["id"]) == ("policy", policy.id)
    assert {c["kind"] for c in told["children"]} == {"run", "verdict", "version"}


@pytest.mark.parametrize(
    "wrong, message",
    [
        ("0" * 8, "is not in the store(.|\n)*(nearest|the last)"),
        ("abc", "8 to 16 hex digits"),
        ("../../x", "not a valid id"),
    ],
)
def test_what_cannot_be_found_is_said_in_one_error(store, small, wrong, message):
    small.lap(store)
    with pytest.raises(StoreError, match=message):
        why(store, wrong)
