"""The lease: one loop at a time on a store, and a number that tells a stale holder from the true one."""

import sqlite3
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from pipeline.errors import StoreError
from pipeline.store.catalog import Catalog
from pipeline.store.folder import ELSEWHERE
from pipeline.store.process import Holder, me, seconds, state

TERM_S = 120.0
"""How long a holder may be silent; it speaks up every quarter of that, and at each commit."""


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to commit. A plain value: the worker processes of one loop may share it.

    Source: the fencing token of M. Kleppmann, Designing Data-Intensive Applications, section 8.4.
    """

    run: str
    fence: int
    """Grows each time the lease changes hands."""
    term_s: float = TERM_S


def take(catalog: Catalog, run: str, command: str | None, term_s: float) -> Lease:
    """Take the lease if it is free, if its holder has died, or if it was not renewed in time.

    Raises:
        StoreError: another loop holds it; the error names who, and says what to do.
    """
    with catalog.write() as db:
        row = db.execute("SELECT fence, held, expires_s, holder FROM lease").fetchone()
        fence, held, expires_s, text = row or (0, 0, 0.0, "")
        if held:
            _refuse_unless_over(Holder.model_validate_json(text), expires_s)
        db.execute(
            "INSERT INTO lease VALUES (1, ?, 1, ?, ?) ON CONFLICT (one) DO UPDATE"
            " SET fence = excluded.fence, held = 1, expires_s = excluded.expires_s, holder = excluded.holder",
            (fence + 1, seconds() + term_s, me(run, command).model_dump_json()),
        )
    return Lease(run, fence + 1, term_s)


def renew(db: sqlite3.Connection, lease: Lease) -> None:
    """Prove that the lease is still held, and hold it for another term; part of every commit.

    Raises:
        StoreError: it has been taken over since.
    """
    row = db.execute("SELECT fence, held, holder FROM lease").fetchone()
    if row is None or (row[0], row[1]) != (lease.fence, 1):
        now = f"it is now held by {Holder.model_validate_json(row[2])}" if row and row[1] else "it has ended"
        raise StoreError(
            f"this loop lost its lease (fence {lease.fence}, the store is at {row[0] if row else 0}): {now}",
            where=f"run {lease.run}",
            mend="nothing was written; once the other loop is done: hardcase loop --resume",
        )
    db.execute("UPDATE lease SET expires_s = ?", (seconds() + lease.term_s,))


def give_back(catalog: Catalog, lease: Lease) -> None:
    """End a lease; one that was lost meanwhile is left alone."""
    with catalog.write() as db:
        db.execute("UPDATE lease SET held = 0 WHERE fence = ?", (lease.fence,))


def holder(catalog: Catalog) -> Holder | None:
    """Who holds the lease and lives, or may live; None when a loop could start now."""
    rows = catalog.rows("SELECT expires_s, holder FROM lease WHERE held = 1")
    if not rows:
        return None
    who = Holder.model_validate_json(str(rows[0][1]))
    return None if _over(who, float(str(rows[0][0]))) else who


@contextmanager
def heartbeat(open_catalog: Callable[[], Catalog], lease: Lease) -> Generator[None]:
    """Renew the lease from a thread while the body runs, so that a long training keeps it.

    A suspended process renews nothing, and that is the point. A lease that was lost is not renewed; the next
    commit says so.
    """
    stop = threading.Event()

    def beat() -> None:
        while not stop.wait(lease.term_s / 4):
            with suppress(StoreError):  # busy or full: the next beat or commit tries again
                catalog = open_catalog()
                try:
                    with catalog.write() as db:
                        renew(db, lease)
                finally:
                    catalog.close()

    thread = threading.Thread(target=beat, name="lease", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _over(who: Holder, expires_s: float) -> bool:
    return state(who) == "dead" or expires_s < seconds()


def _refuse_unless_over(who: Holder, expires_s: float) -> None:
    if not _over(who, expires_s):
        raise StoreError(
            f"another loop uses this store: {who}",
            where="the lease of the store",
            mend=f"wait for it, or end it (kill {who.pid}), or use another folder: {ELSEWHERE}",
        )
