"""hardcase datasets, episodes, derive, diff, export and import as people type them."""

import json

import pytest

from pipeline.store import Store
from stages.build import build


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    with Store.open(tmp_path / "store", create=True, reserve_mb=1) as opened:
        yield opened


@pytest.fixture
def base(store, episode, frames, recipe, task):
    """A version of eight demonstrations, one of which failed, in the store; with the episodes."""
    episodes = [episode(f"demo {k}", length=9 + k, blob=store.put_blob(f"demo {k}".encode()),
                        label="failure" if k == 5 else "success") for k in range(8)]
    wide = recipe.model_copy(update={"dataset": recipe.dataset.model_copy(update={"only_success": False})})
    version = build(episodes, frames, wide, store=store.root, task=task, generation=0)
    store.add_version(version, episodes)
    return version, episodes


@pytest.fixture
def run(store, hardcase):
    """Types a command line at this store."""
    return hardcase


def derived(run, *words):
    code, out, err = run("derive", *words, "--json")
    assert code == 0, err
    return json.loads(out)


def test_derive_keeps_what_a_query_chooses_and_says_why(base, run):
    version, episodes = base
    made = derived(run, version.id[:8], "--keep-where", "outcome == success and not frames < 10")
    assert made["episodes"] == [e.id for k, e in enumerate(episodes) if k not in (0, 5)]
    code, out, _ = run("diff", version.id, made["id"])
    assert code == 0
    assert out.startswith(f"{version.id} -> {made['id']}: 8 -> 6 episodes, 100 -> 77 frames\n  2 episodes less")
    assert "dropped 2 episodes: not (outcome == success and not frames < 10)" in out
    assert f"- {episodes[5].id}" in out and "observation.state: min" in out


def test_diff_of_a_version_with_itself_is_nothing(base, run):
    version, _ = base
    assert run("diff", version.id, version.id)[1] == f"{version.id} and {version.id} hold the same\n"


def test_diff_names_what_changed_in_an_episode(base, run):
    version, episodes = base
    made = derived(run, version.id, "--relabel", f"{episodes[1].id}=failure", "--trim", f"{episodes[2].id}:1:8")
    told = json.loads(run("diff", version.id, made["id"], "--json")[1])
    changed = told["episodes"]["changed"]
    assert changed[episodes[1].id]["outcome"] == ["success", "failure"]
    assert changed[episodes[2].id]["frames"] == [11, 7]
    assert not told["episodes"]["removed"] and "action" in told["statistics"]
    assert not any("rows" in of for of in changed.values())


def test_datasets_lists_versions_with_what_they_share(base, run):
    version, episodes = base
    made = derived(run, version.id, "--relabel", f"{episodes[1].id}=failure")
    first, second = json.loads(run("datasets", "--json")[1])
    assert (first["success"], second["success"]) == (7 / 8, 6 / 8)
    assert second["parents"] == [version.id] and second["sources"] == {"scripted": 8} and second["cameras"] == []
    assert first["shared_bytes"] == second["shared_bytes"] > 10_000 and second["own_bytes"] > 1000
    text = run("datasets")[1]
    assert made["id"] in text and "8 scripted" in text and "shared MB" in text


def test_datasets_and_episodes_answer_queries(base, run):
    version, episodes = base
    rows = json.loads(run("datasets", version.id, "--where", "frames > 14 or outcome == failure", "--json")[1])
    assert [r["id"] for r in rows] == [episodes[k].id for k in (5, 6, 7)]
    rows = json.loads(run("episodes", "--where", "family == dropped", "--json")[1])
    assert [r["id"] for r in rows] == [episodes[5].id]
    assert "8 episodes: 7 scripted success, 1 scripted failure" in run("episodes")[1]


def test_the_same_derivation_twice_is_one_version(base, run, store):
    version, episodes = base
    first = derived(run, version.id, "--drop", episodes[3].id[:9])
    assert derived(run, version.id, "--drop", episodes[3].id) == first
    assert len(store.versions()) == 2


def test_reweighting_takes_a_query(base, run):
    version, _ = base
    made = derived(run, version.id, "--reweight", "outcome == failure=4")
    assert sum(made["weights"].values()) == pytest.approx(1) and len(made["weights"]) <= 2


@pytest.mark.parametrize(("words", "line"), [
    ((), "nothing is to change"),
    (("--drop", "0000000000"), "episode 0000000000 is not in the version"),
    (("--keep-where", "outcome = success"), "a query that cannot be read: '= success' cannot be read"),
    (("--keep-where", "colour == red"), "unknown field 'colour'"),
    (("--keep-where", "frames == many"), "a query that cannot be read: frames is a number, 'many' is none"),
    (("--keep-where", "outcome < success"), "a query that cannot be read: outcome is a text and has no order"),
    (("--keep-where", "(outcome == success"), "a query that cannot be read: ')' is missing before the end"),
    (("--keep-where", "outcome == success; import os"), "a query that cannot be read: 'import' is one word too many"),
    (("--keep-where", "outcome == nothing"), "none of 8 episodes fits the query"),
    (("--trim", "0fd4a1b2"), "'0fd4a1b2' names no frames"),
    (("--reweight", "outcome == success=lots"), "'lots' is no number"),
    (("--reweight", "outcome == success=-1"), "factor: Input should be greater than 0"),
    (("--relabel", "0fd4a1b2"), "'0fd4a1b2' has no value after ="),
    (("--add", "0fd4a1b2"), "id 0fd4a1b2 is not in the store"),
], ids=lambda x: " ".join(x) if isinstance(x, tuple) else "")
def test_bad_words_are_refused_in_one_line(base, run, store, words, line):
    version, _ = base
    code, out, err = run("derive", version.id, *words)
    assert (code, out, err.splitlines()[0]) == (2, "", line)
    assert "  mend: " in err and "Traceback" not in err
    assert len(store.versions()) == 1


def test_relabel_takes_known_outcomes_only(base, run):
    version, episodes = base
    code, _, err = run("derive", version.id, "--relabel", f"{episodes[0].id}=fine")
    assert code == 2 and "outcome: Input should be 'success', 'failure' or 'unknown'" in err


def test_an_episode_is_no_version(base, run):
    _, episodes = base
    code, _, err = run("diff", episodes[0].id, episodes[1].id)
    assert code == 2 and "is no dataset version" in err and "hardcase datasets" in err


@pytest.mark.parametrize(("words", "at"), [
    (("forget", "zz!", "--reason", "x"), "hardcase forget zz!"), (("diff", "ID", "ZZ"), "second VERSION ZZ"),
    (("export", "q", "out"), "VERSION q"), (("derive", "ID", "--add", "xx=0.3"), "--add xx=0.3"),
    (("datasets", "q-q"), "VERSION q-q"),
], ids=["forget", "diff", "export", "derive", "datasets"])
def test_a_malformed_id_is_refused_with_the_place_where_it_was_typed(base, run, words, at):
    code, out, err = run(*(base[0].id if word == "ID" else word for word in words))
    mend = "  mend: give 8 to 16 hex digits of the id of a policy, version, episode, verdict, hard case or run"
    assert (code, out) == (2, "") and err.splitlines()[1:] == [f"  at:   {at}", mend]
