"""One loop at a time, and a stale one writes nothing."""

import os
import pickle
import signal
import time

import pytest

from pipeline.errors import StoreError
from pipeline.store import Lease, Store


def wait_for(path, seconds=10.0):
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, f"{path.name} did not appear"
        time.sleep(0.01)


def hold(root, run, tmp_path, term_s=60.0):
    """A body for a child: take the lease, say so, hold it until told otherwise."""

    def body():
        with Store.open(root) as store, store.lease(run, holder="hardcase loop --seed 7", term_s=term_s):
            (tmp_path / "held").touch()
            wait_for(tmp_path / "stop", 30.0)

    return body


def test_a_second_loop_ends_at_once_and_names_the_first(store, small, tmp_path, children):
    child = children(hold(store.root, small.run, tmp_path))
    wait_for(tmp_path / "held")
    began = time.monotonic()
    with pytest.raises(StoreError) as caught, store.lease(small.run):
        pass
    assert time.monotonic() - began < 1.0
    said = str(caught.value)
    for wanted in (
        f"pid {child}",
        os.uname().nodename,
        "since 2",
        "hardcase loop --seed 7",
        small.run,
        f"kill {child}",
        "HARDCASE_STORE=",
    ):
        assert wanted in said
    assert store.holder().pid == child
    (tmp_path / "stop").touch()
    os.waitpid(child, 0)
    assert store.holder() is None
    with store.lease(small.run) as lease:
        assert lease.fence == 2


def test_the_same_process_cannot_hold_it_twice(store, small):
    again = Store.open(store.root)
    with store.lease(small.run), again, pytest.raises(StoreError, match="another loop uses"), again.lease(small.run):
        pass


def test_a_dead_holder_is_replaced_at_once(store, small, tmp_path, children):
    child = children(hold(store.root, small.run, tmp_path))
    wait_for(tmp_path / "held")
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with store.lease(small.run) as lease:
        assert lease.fence == 2


def test_a_suspended_holder_loses_its_lease_and_its_commit_is_refused(store, small, tmp_path, children):
    def body():
        with Store.open(store.root) as own, own.lease(small.run, term_s=0.4) as lease:
            (tmp_path / "held").touch()
            wait_for(tmp_path / "go", 30.0)
            try:
                with own.commit(lease) as tx:
                    tx.add_run(small.info(command="stale"))
            except StoreError as error:
                (tmp_path / "refused").write_text(str(error))

    child = children(body)
    wait_for(tmp_path / "held")
    time.sleep(1.0)  # more than a term: a holder that runs keeps its lease
    with pytest.raises(StoreError, match="another loop"), store.lease(small.run):
        pass
    os.kill(child, signal.SIGSTOP)
    time.sleep(0.6)
    with store.lease(small.run) as lease:
        with store.commit(lease) as tx:
            tx.add_run(small.info())
        (tmp_path / "go").touch()
        os.kill(child, signal.SIGCONT)
        wait_for(tmp_path / "refused")
        said = (tmp_path / "refused").read_text()
        assert "lost its lease (fence 1, the store is at 2)" in said and f"pid {os.getpid()}" in said
        assert "hardcase loop --resume" in said
        os.waitpid(child, 0)  # its end must not free the lease of the other
        with pytest.raises(StoreError, match="another loop"), Store.open(store.root).lease(small.run):
            pass
        with store.commit(lease) as tx:
            tx.finish_step(0, "collect")
    assert [i.command for i in store.history(small.run)] == [small.info().command]


def test_a_lease_can_be_handed_to_the_workers_of_its_loop(store, small, in_child):
    with store.lease(small.run) as lease:

        def body():
            with Store.open(store.root) as own, own.commit(pickle.loads(pickle.dumps(lease))) as tx:  # noqa: S301
                tx.add_run(small.info())

        assert in_child(body) == 0
    assert list(store.runs()) == [small.run]


def test_a_lease_that_was_given_back_is_over(store, small):
    with store.lease(small.run) as lease:
        pass
    with pytest.raises(StoreError, match="it has ended"), store.commit(lease) as tx:
        tx.add_run(small.info())


def test_an_invented_lease_is_refused(store, small):
    with pytest.raises(StoreError, match="lost its lease"), store.commit(Lease(small.run, 99)) as tx:
        tx.add_run(small.info())
    assert store.runs() == {}
