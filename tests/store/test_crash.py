"""Whole or absent, whenever the power goes; acknowledged is kept, whoever is killed."""

import errno
import os
import random
import resource
import signal
import time

import pytest

from pipeline.errors import StoreError
from pipeline.files import short_id
from pipeline.store import Store

SEED = 20260601


def one_step(store, small):
    """Collect and build in one lap of three commits; the content follows from `small` alone."""
    with store.lease(small.run) as lease:
        if not store.step(small.run, 0, "collect"):
            demos = [small.episode(k, blob=store.put_blob(small.recording(k))) for k in range(2)]
            with store.commit(lease) as tx:
                tx.add_run(small.info())
                tx.add_episodes(demos)
                tx.finish_step(0, "collect", outputs={"episodes": [e.id for e in demos]})
        demos = store.episodes(store.step(small.run, 0, "collect").outputs["episodes"])
        version = small.version(demos)
        policy = small.policy(version)
        if not store.step(small.run, 0, "train"):
            small.write_folders(store, version, policy)
            with store.commit(lease) as tx:
                tx.add_version(version)
                tx.add_policy(policy)
                tx.add_release(small.release(1, policy, kind="bootstrap"))
                tx.finish_step(0, "train", outputs={"policy": policy.id})


def content(store, small):
    return (
        store.episodes(),
        store.versions(),
        store.policies(),
        store.releases(small.run),
        [s.model_dump() for s in store.steps(small.run)],
        sorted(p.name for p in store.root.glob("blobs/*")),
    )


@pytest.fixture
def whole(tmp_path, small):
    names: list[str] = []
    with Store.open(tmp_path / "whole", create=True, fault=names.append) as store:
        one_step(store, small)
        return names, content(store, small)


def test_a_kill_before_any_fsync_rename_or_commit_leaves_a_step_whole_or_absent(tmp_path, small, in_child, whole):
    names, wanted = whole
    print(f"seed {small.seed}, {len(names)} points: {names}")
    assert {
        "migrate 1",
        "fsync blob",
        "rename blob",
        "fsync blob folder",
        "fsync file",
        "fsync folder",
        "commit",
    } <= set(names)
    for point, name in enumerate(names):
        root = tmp_path / f"killed-{point}"

        def body(root=root, point=point):
            left = iter(range(point + 1))

            def fault(_: str) -> None:
                if next(left) == point:
                    os.kill(os.getpid(), signal.SIGKILL)

            with Store.open(root, create=True, fault=fault) as store:
                one_step(store, small)

        assert in_child(body) == -signal.SIGKILL, f"point {point}, {name}"
        with Store.open(root, create=True) as store:
            done = {s.stage for s in store.steps(small.run)}
            assert len(store.episodes()) == (2 if "collect" in done else 0)
            assert len(store.policies()) == len(store.releases(small.run)) == (1 if "train" in done else 0)
            assert not store.verify()
            one_step(store, small)
            assert content(store, small) == wanted, f"killed at point {point}, {name}"


@pytest.mark.parametrize("name", ["fsync blob", "rename blob", "fsync blob folder", "fsync file", "fsync folder"])
def test_a_full_disk_at_any_write_is_said_and_latched(root, small, name, whole):
    def fault(at: str) -> None:
        if at == name and armed:
            raise OSError(errno.ENOSPC, "No space left on device")

    armed = True
    with Store.open(root, create=True, fault=fault) as store:
        with pytest.raises(StoreError, match=r"no space left(.|\n)*hardcase gc(.|\n)*hardcase loop --resume"):
            one_step(store, small)
        armed = False
        if store.step(small.run, 0, "collect") is None:
            assert store.episodes() == []
        # a stage that overlooked the error must not mark itself finished
        with store.lease(small.run) as lease, pytest.raises(StoreError, match="no space"), store.commit(lease) as tx:
            tx.add_run(small.info())
            tx.finish_step(0, "collect")
    assert list((root / "tmp").iterdir()) == []
    with Store.open(root) as store:
        one_step(store, small)
        assert content(store, small) == whole[1]


@pytest.mark.parametrize("what", ["blob", "catalog"])
def test_a_write_that_the_system_refuses_leaves_nothing_half_done(root, small, in_child, tmp_path, what):
    Store.open(root, create=True).close()

    def body():
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, resource.RLIM_INFINITY))
        with Store.open(root) as store, store.lease(small.run) as lease:
            try:
                with store.commit(lease) as tx:
                    tx.add_run(small.info())
                    if what == "blob":
                        tx.add_episodes([small.episode(0, blob=store.put_blob(bytes(500_000)))])
                    tx.add_episodes(small.episode(k) for k in range(2000))
                    tx.finish_step(0, "collect")
            except StoreError as error:
                (tmp_path / "said").write_text(str(error))

    assert in_child(body) == 0
    assert "no space left" in (tmp_path / "said").read_text()
    with Store.open(root) as store:
        assert (store.runs(), store.episodes(), list((root / "tmp").iterdir())) == ({}, [], [])
        one_step(store, small)
        assert store.champion(small.run)


def test_four_killed_writers_lose_nothing_that_was_acknowledged(store, small, children):
    chance = random.Random(SEED)
    print(f"seed {SEED}")
    acknowledged: list[str] = []
    with store.lease(small.run) as lease:
        with store.commit(lease) as tx:
            tx.add_run(small.info())
        for life in range(4):
            pipes = [os.pipe() for _ in range(4)]
            for worker, (_, out) in enumerate(pipes):

                def body(out=out, first=1_000_000 * (4 * life + worker)):
                    with Store.open(store.root) as own:
                        for k in range(first, first + 100_000):
                            episode = small.episode(k, id=short_id(k), blob=own.put_blob(small.recording(k)))
                            with own.commit(lease) as tx:
                                tx.add_episodes([episode])
                            os.write(out, f"{episode.id}\n".encode())

                pipes[worker] = (pipes[worker][0], out, children(body))
            for _, out, child in pipes:
                os.close(out)
                time.sleep(chance.uniform(0.05, 0.3))
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
            for read, _, _ in pipes:  # after the last has died: each inherited the others' ends
                with os.fdopen(read) as lines:
                    acknowledged += [line.strip() for line in lines if line.endswith("\n")]
    assert len(acknowledged) > 50
    kept = {e.id for e in store.episodes()}
    assert set(acknowledged) <= kept
    assert len(kept) <= len(acknowledged) + 16  # at most the commit that each was killed in
    assert store.verify() == []
    assert store.query("PRAGMA integrity_check") == [("ok",)]
    print(f"{len(acknowledged)} acknowledged by 16 killed writers, {len(kept)} kept")
