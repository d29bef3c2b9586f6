"""The split: lineages never straddle it, and what was once held out stays so."""

import hashlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import DatasetError
from pipeline.lerobot_view.split import DRAWN, Decided, held_out, lineages, starts
from pipeline.simulation.tasks import FAMILY_BASE, scene_seed
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import SceneSpec

SCENE = SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                  object_xy_m=(0.3, 0.0), object_yaw_rad=0.0, object_half_m=0.02, target_xy_m=(0.3, 0.1))


def name(k: int) -> str:
    return hashlib.sha256(str(k).encode()).hexdigest()[:16]


def made(k: int, parent: int | None, seed: int = 1) -> Episode:
    return Episode(id=name(k), origin="scripted" if parent is None else "replayed", control_hz=20,
                   scene=SCENE.model_copy(update={"seed": seed}),
                   frames=3, outcome=Outcome(label="success", judged_by="simulator"), generation=0, blob="0" * 64,
                   segments=(Segment(kind="demonstration", start=0, stop=3, actor="expert"),),
                   parent=None if parent is None else name(parent))


@st.composite
def families(draw):
    """Episodes that may each be made from any earlier one, some of which are then dropped."""
    count = draw(st.integers(1, 40))
    parents = [draw(st.one_of(st.none(), st.integers(0, k - 1))) if k else None for k in range(count)]
    everything = [made(k, parent) for k, parent in enumerate(parents)]
    kept = draw(st.lists(st.sampled_from(everything), min_size=1, unique_by=lambda e: e.id))
    return everything, kept


def split(everything, kept, share, decided=None):
    every = lineages(everything)
    roots = {e.id: every[e.id] for e in kept}
    held = held_out(roots, share, decided or Decided(), starts(everything))
    return {e for e, root in roots.items() if root in held}, roots


@settings(deadline=None)
@given(families=families(), share=st.floats(0, 0.49))
def test_a_demonstration_and_all_that_was_made_from_it_are_on_one_side(families, share):
    everything, kept = families
    held, _ = split(everything, kept, share)
    here = {e.id for e in kept}
    for episode in everything:
        if episode.parent and {episode.id, episode.parent} <= here:
            assert (episode.id in held) == (episode.parent in held)
    children = [e for e in everything if e.parent]
    for one in children:
        for other in children:
            if one.parent == other.parent and {one.id, other.id} <= here:
                assert (one.id in held) == (other.id in held)
    assert len(held) < len(kept)


@settings(deadline=None)
@given(families=families(), more=st.integers(0, 20), shares=st.tuples(st.floats(0, 0.49), st.floats(0, 0.49)))
def test_a_derived_version_keeps_every_decision(families, more, shares):
    everything, kept = families
    held, roots = split(everything, kept, shares[0])
    added = [made(100 + k, None) for k in range(more)] + [made(200, 0), made(201, 200)]
    decided = Decided(frozenset(held), frozenset(roots) - held)
    later, _ = split([*everything, *added], [*kept, *added], shares[1], decided)
    assert {e.id for e in kept if e.id in later} == held


@settings(deadline=None)
@given(families=families(), share=st.floats(0.01, 0.49))
def test_the_order_of_the_episodes_decides_nothing(families, share):
    everything, kept = families
    assert split(everything, kept, share)[0] == split(everything[::-1], kept[::-1], share)[0]


def test_about_the_wanted_share_of_lineages_is_held_out():
    demos = [made(k, None) for k in range(2000)]
    held, _ = split(demos, demos, 0.1)
    assert 160 < len(held) < 240


def test_two_lineages_that_turn_out_to_be_one_are_held_out_together():
    """Version 1 knows two copies whose common ancestor it has not seen; version 2 sees it."""
    copies = [made(1, 7), made(2, 8)]
    decided = Decided(frozenset({name(1)}), frozenset({name(2)}))
    everything = [made(0, None), made(7, 0), made(8, 0), *copies, made(9, None)]
    held, _ = split(everything, [*copies, everything[-1]], 0.01, decided)
    assert {name(1), name(2)} <= held


def test_nothing_left_to_train_on_is_refused():
    with pytest.raises(DatasetError, match=r"every lineage .* held out\n.*\n  mend: add demonstrations"):
        split([made(0, None)], [made(0, None)], 0.1, Decided(frozenset({name(0)})))


def test_a_circle_of_parents_is_refused():
    with pytest.raises(DatasetError, match=r"its own ancestor\n.*\n  mend: drop"):
        lineages([made(1, 2), made(2, 1)])


def begun(code, demos=60):
    """Demonstrations at drawn starts and a variant of each; their ids follow from `code` as well."""
    first = [made(10_000 * code + k, None, scene_seed("demo", 0, k)) for k in range(demos)]
    return first, [made(10_000 * code + 5_000 + k, 10_000 * code + k, 2) for k in range(demos)]


def test_a_start_stays_on_its_side_when_code_gives_its_episodes_other_ids():
    sides = []
    for code in (1, 2):
        first, variants = begun(code)
        held, _ = split([*first, *variants], [*first, *variants], 0.2)
        sides.append([(e.id in held, v.id in held) for e, v in zip(first, variants, strict=True)])
    assert sides[0] == sides[1]
    assert {demo == variant for demo, variant in sides[0]} == {True}
    assert 3 < sum(demo for demo, _ in sides[0]) < 25


def test_two_attempts_at_one_start_are_on_one_side():
    first, second = begun(1), begun(2)
    everything = [*first[0], *second[0]]
    held, _ = split(everything, everything, 0.2)
    assert [e.id in held for e in first[0]] == [e.id in held for e in second[0]]
    only = [first[0][0], second[0][0], first[0][1]]  # two starts: one of them is held out whole, the other taught
    held, _ = split(only, only, 0.01)
    assert len({only[0].id in held, only[1].id in held}) == 1
    assert 0 < len(held) < 3


def test_a_later_attempt_at_a_decided_start_joins_its_side():
    first, second = begun(1)[0], begun(2)[0]
    decided = Decided(frozenset(e.id for e in first[:30]), frozenset(e.id for e in first[30:]))
    held, _ = split([*first, *second], [*first, *second], 0.2, decided)
    assert [e.id in held for e in second] == [True] * 30 + [False] * 30


@pytest.mark.parametrize("family", FAMILY_BASE)
def test_the_split_knows_a_drawn_seed_from_one_that_means_nothing(family):
    episode = made(1, None, scene_seed(family, 0, 0))
    assert starts([episode]) == {episode.id: f"demo {episode.scene.seed}"}
    assert starts([made(1, None, seed) for seed in (0, 1, DRAWN - 1)]) == {}
