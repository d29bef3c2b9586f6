"""Which episodes `hardcase browse` finds, and what it says where it finds none."""

import pytest

from flows.browse.query import choose
from pipeline.errors import ConfigError, StoreError


def test_without_words_everything_is_shown(shelf, store):
    assert len(choose(store, (), 500).episodes) == 5


def test_words_are_joined_by_and(shelf, store):
    found = choose(store, ("outcome=failure", "family=dropped-carry", "generation=2"), 500)
    assert [e.id for e in found.episodes] == [shelf.failure.id] and not found.single
    assert {e.id for e in choose(store, ("source=retargeted",), 500).episodes} == {
        e.id for e in shelf.variants if e.origin == "retargeted"}


def test_the_grammar_of_versions_is_understood_as_well(shelf, store):
    found = choose(store, ("success == true and source not in (replayed, retargeted)",), 500)
    assert {e.id for e in found.episodes} == {e.id for e in shelf.demonstrations}


def test_the_first_digits_of_a_parent_are_enough(shelf, store):
    parent = shelf.variants[0].parent
    found = choose(store, (f"parent={parent[:8]}",), 500)
    assert {e.parent for e in found.episodes} == {parent}


def test_an_id_opens_one_episode_or_all_of_a_run(shelf, store):
    one = choose(store, (shelf.failure.id[:8],), 500)
    assert one.single and one.episodes == (store.episode(shelf.failure.id),)


def test_the_newest_are_kept_where_there_are_too_many(shelf, store):
    found = choose(store, (), 2)
    assert found.episodes[-1].id == shelf.failure.id and found.more == 3


@pytest.mark.parametrize(("words", "mend"), [
    (("colour=red",), "use one of: family, frames, generation, outcome"),
    (("outcom=failure",), "do you mean outcome"),
    (("generation=two",), "write it so"),
    (("family=stalled",), r"there are family: none \(4\), dropped-carry \(1\)"),
    (("outcome=",), "write it so"),
], ids=["unknown field", "a slip", "no number", "nothing matches", "no value"])
def test_what_cannot_be_found_says_what_can(shelf, store, words, mend):
    with pytest.raises(ConfigError, match=f"mend: .*{mend}"):
        choose(store, words, 500)


def test_an_id_that_is_not_there_is_refused(shelf, store):
    with pytest.raises(StoreError, match="is not in the store"):
        choose(store, ("0123456789abcdef",), 500)
