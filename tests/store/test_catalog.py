"""What goes in comes out, the same for ever."""

import sqlite3
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store import Store
from pipeline.store.catalog import MIGRATIONS, Catalog


def test_a_lap_reads_back_as_it_was_written(store, small):
    policy = small.lap(store)
    assert store.policy(policy.id) == policy
    assert store.version(policy.dataset).episodes == tuple(
        e.id for e in store.episodes(generation=0) if e.policy is None
    )
    assert store.champion(small.run).policy == policy.id
    assert store.step(small.run, 0, "train").outputs == {"policy": policy.id}
    assert store.step(small.run, 1, "train") is None
    assert [s.stage for s in store.steps(small.run)] == [
        "collect",
        "augment",
        "build",
        "train",
        "gate",
        "release",
        "harvest",
    ]
    assert store.runs() == {small.run: small.info()}
    assert store.verdicts(candidate=policy.id) == [small.verdict(policy)]
    assert not store.verify()


def test_a_lap_reads_back_after_reopening(root, small):
    with Store.open(root, create=True) as store:
        policy = small.lap(store)
    with Store.open(root) as again:
        assert again.policy(policy.id) == policy
        assert again.steps(small.run)[0].wall_s == 1.5


def test_episodes_are_found_by_what_they_are(store, small):
    policy = small.lap(store)
    assert len(store.episodes(origin="scripted")) == 6
    assert {e.parent for e in store.episodes(origin="retargeted")} == {e.id for e in store.episodes(origin="scripted")}
    assert [e.policy for e in store.episodes(label="failure")] == [policy.id]
    assert all(e.scene.stratum == "large" for e in store.episodes(stratum="large"))
    assert store.episodes(run="0" * 16) == []
    ids = [e.id for e in store.episodes()][::-1]
    assert [e.id for e in store.episodes(ids)] == ids


def test_a_lap_written_twice_is_there_once(store, small):
    small.lap(store)
    before = [store.episodes(), store.steps(small.run), store.releases(small.run), store.history(small.run)]
    small.lap(store)
    assert before == [store.episodes(), store.steps(small.run), store.releases(small.run), store.history(small.run)]


@pytest.mark.parametrize(
    "table, change",
    [
        ("episode", {"frames": 11}),
        ("version", {"frames": 99}),
        ("policy", {"steps": 7}),
        ("step", {}),
        ("verdict", {"scenes": 5}),
    ],
)
def test_what_is_stored_never_changes(store, small, table, change):
    policy = small.lap(store)
    version = store.version(policy.dataset)
    demo = store.episodes(origin="scripted")[0]
    with (
        store.lease(small.run) as lease,
        pytest.raises(StoreError, match=r"in the store with another (.|\n)*HARDCASE_STORE"),
        store.commit(lease) as tx,
    ):
        match table:
            case "episode":
                tx.add_episodes([demo.model_copy(update={"control_hz": 50.0})])
            case "version":
                tx.add_version(version.model_copy(update=change))
            case "policy":
                tx.add_policy(policy.model_copy(update=change))
            case "verdict":
                tx.add_verdict(small.verdict(policy, **change))
            case _:
                tx.finish_step(0, "train", outputs={"policy": "another"})


def test_a_step_that_fails_leaves_no_row(store, small):
    small.lap(store)
    with store.lease(small.run) as lease, pytest.raises(RuntimeError, match="power cut"), store.commit(lease) as tx:
        tx.add_episodes([small.episode(500)])
        tx.finish_step(1, "collect")
        raise RuntimeError("power cut")
    assert store.step(small.run, 1, "collect") is None
    assert small.episode(500).id not in {e.id for e in store.episodes()}


@pytest.mark.parametrize(
    "what", ["blob", "parent", "policy", "version folder", "policy file", "episode of a version", "run"]
)
def test_a_row_never_speaks_of_what_is_not_there(store, small, what):
    policy = small.lap(store)
    version, demo = store.version(policy.dataset), store.episodes()[0]
    missing = "0123456789abcdef"
    with (
        store.lease(small.run) as lease,
        pytest.raises(StoreError, match=r"(not in the store|is missing)(.|\n)*mend: (add|write|make|start) "),
        store.commit(lease, run="f" * 16 if what == "run" else None) as tx,
    ):
        match what:
            case "blob":
                tx.add_episodes([small.episode(501, blob="0" * 64)])
            case "parent":
                tx.add_episodes([small.variant(502, of=demo.model_copy(update={"id": missing}))])
            case "policy":
                tx.add_episodes([small.episode(503, policy=missing)])
            case "version folder":
                tx.add_version(version.model_copy(update={"id": missing, "path": "versions/none"}))
            case "policy file":
                tx.add_policy(policy.model_copy(update={"id": missing, "files": {"lost.safetensors": "0" * 64}}))
            case "episode of a version":
                tx.add_version(version.model_copy(update={"id": missing, "episodes": (missing,)}))
            case _:
                tx.add_episodes([small.episode(504)])


def test_an_unknown_id_names_its_neighbours(store, small):
    policy = small.lap(store)
    wrong = policy.id[:-1] + ("0" if policy.id[-1] != "0" else "1")
    with pytest.raises(StoreError, match=f"policy {wrong} is not in the store(.|\n)*nearest: policy {policy.id}"):
        store.policy(wrong)
    with pytest.raises(StoreError, match=r"verdict 0{16} is not in the store(.|\n)*(nearest|the last): verdict"):
        store.verdict("0" * 16)


def test_an_unknown_id_in_an_empty_store_says_how_to_begin(store):
    with pytest.raises(StoreError, match="holds none yet: hardcase loop"):
        store.policy("0" * 16)


@pytest.mark.parametrize(
    "bad", ["../../etc/passwd", "%2e%2e%2f", "a" * 7, "A" * 16, "0123456789abcde\0", "0" * 16 + "\n"]
)
def test_only_ids_become_part_of_a_query_or_a_path(store, bad):
    for ask in (store.policy, store.episode, store.run, store.releases, store.find, store.blob):
        with pytest.raises(StoreError, match=r"not a valid (.|\n)*mend: .*hex digits"):
            ask(bad)


@pytest.mark.parametrize("bad", ["../outside", "/etc", "versions/../../outside", "a\0b", "link/x", ".", ""])
def test_stored_paths_never_lead_out_of_the_store(store, tmp_path, bad):
    (tmp_path / "outside").mkdir()
    (store.root / "link").symlink_to(tmp_path / "outside")
    with pytest.raises(StoreError, match="leads out of the store"):
        store.path(bad)


def test_find_takes_the_beginning_of_an_id(store, small):
    policy = small.lap(store)
    assert store.find(policy.id[:8]) == ("policy", policy.id)
    assert store.find(small.run) == ("run", small.run)


def test_the_champion_only_moves_on(store, small):
    first = small.lap(store)
    second = small.policy(store.version(first.dataset), seed=1)
    small.write_folders(store, store.version(first.dataset), second)
    with store.lease(small.run) as lease:
        with store.commit(lease) as tx:
            tx.add_policy(second)
            tx.add_release(small.release(2, second, previous=first.id))
        with store.commit(lease) as tx:
            tx.add_release(small.release(3, first, previous=second.id, kind="rollback"))
        with pytest.raises(StoreError, match=f"the champion is {first.id}, not {second.id}"), store.commit(lease) as tx:
            tx.add_release(small.release(4, second, previous=second.id))
        with pytest.raises(StoreError, match="use the next number, 4"), store.commit(lease) as tx:
            tx.add_release(small.release(9, second, previous=first.id))
        with pytest.raises(StoreError, match="with another policy"), store.commit(lease) as tx:
            tx.add_release(small.release(1, second, previous=None, kind="bootstrap"))
    assert [(r.number, r.policy) for r in store.releases(small.run)] == [(1, first.id), (2, second.id), (3, first.id)]
    assert store.champion(small.run).kind == "rollback"


def test_a_hard_case_takes_its_correction_once(store, small):
    small.lap(store)
    (case,) = store.hard_cases()
    fix = small.episode(700, id="c0ffee0000000000", origin="corrected", parent=case.episode)
    corrected = case.model_copy(update={"correction": fix.id, "corrected": True})
    with store.lease(small.run) as lease:
        with store.commit(lease) as tx:
            tx.add_episodes([fix])
            tx.add_hard_cases([corrected])
        assert store.hard_cases(corrected=True) == [corrected]
        with pytest.raises(StoreError, match="another correction"), store.commit(lease) as tx:
            tx.add_hard_cases([corrected.model_copy(update={"correction": case.episode})])


def test_a_run_keeps_the_history_of_its_invocations(store, small):
    small.lap(store)
    with store.lease(small.run) as lease:
        with store.commit(lease) as tx:
            tx.add_run(small.info(command="hardcase loop --resume", commit="def5678"))
        with (
            pytest.raises(StoreError, match="two loops: recipe, seed, twin or control differ"),
            store.commit(lease) as tx,
        ):
            tx.add_run(small.info(seed=9))
    assert [i.commit for i in store.history(small.run)] == ["abc1234", "def5678"]
    assert store.run(small.run).commit == "abc1234"


def test_a_newer_catalog_is_refused_with_the_way_out(root, store):
    store.close()
    with sqlite3.connect(root / "catalog.db") as db:
        db.execute(f"PRAGMA user_version = {len(MIGRATIONS) + 1}")
    numbers = rf"\(schema {len(MIGRATIONS) + 1}, this one knows {len(MIGRATIONS)}\)"
    with pytest.raises(StoreError, match=rf"newer Hardcase {numbers}(.|\n)*git pull && uv sync"):
        Store.open(root)


def test_an_older_catalog_is_brought_up_and_keeps_its_rows(root, store, small):
    policy = small.lap(store)
    store.close()
    more = (*MIGRATIONS, "CREATE TABLE note (id TEXT PRIMARY KEY, text TEXT NOT NULL) STRICT;")
    catalog = Catalog(root, migrations=more)
    assert catalog.rows("SELECT count(*) FROM note") == [(0,)]
    assert catalog.rows("SELECT id FROM policy") == [(policy.id,)]
    catalog.close()
    with pytest.raises(StoreError, match="newer Hardcase"):
        Store.open(root)


def test_a_migration_that_fails_changes_nothing(root, store):
    store.close()
    with pytest.raises(StoreError, match="no such table"):
        Catalog(root, migrations=(*MIGRATIONS, "CREATE TABLE note (id TEXT) STRICT; DROP TABLE absent;"))
    with Store.open(root) as again:
        assert again.query("SELECT name FROM sqlite_schema WHERE name = 'note'") == []


@pytest.mark.parametrize(
    "make, message",
    [
        (
            lambda path: path.write_bytes(b"not a database, but long enough to be looked at" * 100),
            "the catalog is damaged",
        ),
        (lambda path: sqlite3.connect(path).executescript("CREATE TABLE theirs (x)").close(), "not a Hardcase catalog"),
    ],
    ids=["damaged", "of another program"],
)
def test_a_strange_catalog_is_refused(root: Path, make, message):
    root.mkdir()
    make(root / "catalog.db")
    with pytest.raises(StoreError, match=message) as caught:
        Store.open(root)
    assert "HARDCASE_STORE=" in caught.value.mend
