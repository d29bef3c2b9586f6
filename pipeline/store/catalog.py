"""The SQLite file of a store: opened, migrated, and written by one process at a time."""

import fcntl
import os
import sqlite3
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.folder import ELSEWHERE, FaultPoint, busy, explain, no_fault

APPLICATION = 0x48435331  # 'HCS1' in the file header: tells our catalog from any other SQLite file
WAL_PAGES = 1000
WAIT_S = 10.0

MIGRATIONS: tuple[str, ...] = (
    """
    CREATE TABLE lease (
        one INTEGER PRIMARY KEY CHECK (one = 1),
        fence INTEGER NOT NULL,
        held INTEGER NOT NULL,
        expires_s REAL NOT NULL,
        holder TEXT NOT NULL
    ) STRICT;
    CREATE TABLE run (id TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT;
    CREATE TABLE invocation (
        run TEXT NOT NULL REFERENCES run, number INTEGER NOT NULL, json TEXT NOT NULL, PRIMARY KEY (run, number)
    ) STRICT;
    CREATE TABLE step (
        run TEXT NOT NULL REFERENCES run, generation INTEGER NOT NULL, stage TEXT NOT NULL, json TEXT NOT NULL,
        PRIMARY KEY (run, generation, stage)
    ) STRICT;
    CREATE TABLE policy (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, dataset TEXT NOT NULL REFERENCES version (id),
        generation INTEGER NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE episode (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, origin TEXT NOT NULL, generation INTEGER NOT NULL,
        label TEXT NOT NULL, stratum TEXT NOT NULL,
        parent TEXT REFERENCES episode (id) DEFERRABLE INITIALLY DEFERRED,
        policy TEXT REFERENCES policy (id), blob TEXT, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX episode_parent ON episode (parent);
    CREATE INDEX episode_policy ON episode (policy);
    CREATE INDEX episode_blob ON episode (blob);
    CREATE TABLE version (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, parent TEXT REFERENCES version (id),
        generation INTEGER NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE version_episode (
        version TEXT NOT NULL REFERENCES version (id), episode TEXT NOT NULL REFERENCES episode (id),
        PRIMARY KEY (version, episode)
    ) STRICT, WITHOUT ROWID;
    CREATE INDEX episode_version ON version_episode (episode);
    CREATE TABLE version_input (
        version TEXT NOT NULL REFERENCES version (id), blob TEXT NOT NULL, PRIMARY KEY (version, blob)
    ) STRICT, WITHOUT ROWID;
    CREATE TABLE verdict (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, candidate TEXT NOT NULL REFERENCES policy (id),
        generation INTEGER NOT NULL, decision TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE release (
        run TEXT NOT NULL REFERENCES run, number INTEGER NOT NULL, policy TEXT NOT NULL REFERENCES policy (id),
        json TEXT NOT NULL, PRIMARY KEY (run, number)
    ) STRICT;
    CREATE TABLE hard_case (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, episode TEXT NOT NULL REFERENCES episode (id),
        correction TEXT REFERENCES episode (id), family TEXT NOT NULL, stratum TEXT NOT NULL,
        generation INTEGER NOT NULL, corrected INTEGER NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE member (
        run TEXT NOT NULL REFERENCES run, kind TEXT NOT NULL, id TEXT NOT NULL, generation INTEGER, stage TEXT,
        PRIMARY KEY (run, kind, id)
    ) STRICT, WITHOUT ROWID;
    CREATE INDEX member_id ON member (id);
    """,
    """
    CREATE TABLE consent (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, operator TEXT NOT NULL, site TEXT NOT NULL,
        expires TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE consent_end (
        consent TEXT PRIMARY KEY REFERENCES consent (id), json TEXT NOT NULL
    ) STRICT;
    """,
    """
    CREATE TABLE checked (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, subject TEXT NOT NULL, passed INTEGER NOT NULL,
        contract TEXT NOT NULL, code TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX checked_subject ON checked (subject);
    """,
    """
    CREATE TABLE raw_log (id TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT;
    CREATE TABLE conversion (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, log TEXT NOT NULL REFERENCES raw_log (id),
        state TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX conversion_log ON conversion (log);
    CREATE TABLE ingestion (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, conversion TEXT NOT NULL REFERENCES conversion (id),
        json TEXT NOT NULL
    ) STRICT;
    """,
    """
    CREATE TABLE erasure (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE TABLE erased (
        id TEXT PRIMARY KEY, kind TEXT NOT NULL, erasure TEXT NOT NULL REFERENCES erasure (id)
    ) STRICT, WITHOUT ROWID;
    CREATE TABLE erased_version (
        version TEXT NOT NULL REFERENCES version (id), episode TEXT NOT NULL, PRIMARY KEY (version, episode)
    ) STRICT, WITHOUT ROWID;
    CREATE INDEX erased_in_version ON erased_version (episode);
    CREATE INDEX policy_dataset ON policy (dataset);
    CREATE INDEX version_parent ON version (parent);
    CREATE INDEX version_blob ON version_input (blob);
    CREATE INDEX verdict_candidate ON verdict (candidate);
    CREATE INDEX release_policy ON release (policy);
    CREATE INDEX hard_case_episode ON hard_case (episode);
    CREATE INDEX hard_case_correction ON hard_case (correction);
    CREATE INDEX ingestion_conversion ON ingestion (conversion);
    CREATE INDEX episode_transform ON episode (json_extract(json, '$.transform'));
    CREATE INDEX episode_consent ON episode (json_extract(json, '$.consent'));
    """,
    """
    CREATE TABLE worth (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, version TEXT NOT NULL REFERENCES version (id),
        batch TEXT NOT NULL, decision TEXT NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX worth_batch ON worth (batch);
    CREATE INDEX worth_version ON worth (version);
    """,
    """
    CREATE TABLE night (
        run TEXT NOT NULL REFERENCES run, generation INTEGER NOT NULL, day INTEGER NOT NULL, json TEXT NOT NULL,
        PRIMARY KEY (run, generation)
    ) STRICT;
    """,
    """
    CREATE TABLE failure_family (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE,
        medoid TEXT NOT NULL REFERENCES episode (id) ON DELETE CASCADE,
        generation INTEGER NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX failure_family_medoid ON failure_family (medoid);
    CREATE TABLE regression_scene (
        place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE,
        hard_case TEXT NOT NULL REFERENCES hard_case (id) ON DELETE CASCADE,
        generation INTEGER NOT NULL, json TEXT NOT NULL
    ) STRICT;
    CREATE INDEX regression_scene_case ON regression_scene (hard_case);
    """,
)
"""Migration k brings a catalog from schema k to k + 1. Never edit one that was released; append."""


class Catalog:
    """One connection, for any number of threads; writers of all processes take turns.

    Turns are taken by a lock on `catalog.lock`, and the WAL is checkpointed only within a turn: SQLite before
    3.51.3 can lose commits when a checkpoint and a writer that restarts the WAL meet (https://sqlite.org/wal.html,
    "the WAL-reset bug"), and the SQLite of a distribution is often older.
    """

    def __init__(self, root: Path, fault: FaultPoint = no_fault, migrations: tuple[str, ...] = MIGRATIONS) -> None:
        self.path, self._fault = root / "catalog.db", fault
        self._guard = threading.RLock()
        try:
            self._lock = os.open(root / "catalog.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise explain(error, root) from error
        try:
            self.db = sqlite3.connect(self.path, timeout=WAIT_S, autocommit=True, check_same_thread=False)
            try:
                self._prepare(migrations)
            except BaseException:
                self.db.close()
                raise
        except sqlite3.Error as error:
            os.close(self._lock)
            raise explain(error, self.path) from error
        except BaseException:
            os.close(self._lock)
            raise

    def close(self) -> None:
        """Give everything back; the catalog stays whole with or without this."""
        with self._guard:
            self.db.close()
            if self._lock >= 0:  # closing a number twice would close somebody else's file
                os.close(self._lock)
                self._lock = -1

    def rows(self, sql: str, parameters: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
        """All rows of a query, as of the last commit (or of the open transaction of this thread)."""
        try:
            with self._guard:
                return self.db.execute(sql, parameters).fetchall()
        except sqlite3.Error as error:
            raise explain(error, self.path) from error

    @contextmanager
    def turn(self) -> Generator[None]:
        """Be the only writer of all processes and threads for a while."""
        with self._guard:
            self._take()
            try:
                yield
            finally:
                fcntl.flock(self._lock, fcntl.LOCK_UN)

    @contextmanager
    def write(self) -> Generator[sqlite3.Connection]:
        """One transaction: all of it once this returns, none of it when the body raises.

        Raises:
            StoreError: no space, a damaged file, or another writer for over 10 s.
        """
        with self.turn():
            try:
                self.db.execute("BEGIN IMMEDIATE")
                yield self.db
                self._fault("commit")
                self.db.execute("COMMIT")
            except sqlite3.Error as error:
                self._roll_back()
                raise explain(error, self.path) from error
            except BaseException:
                self._roll_back()
                raise
            self._checkpoint()

    def _roll_back(self) -> None:
        if self.db.in_transaction:  # SQLite itself rolls back after some errors, a full disk among them
            self.db.execute("ROLLBACK")

    def _take(self) -> None:
        deadline, pause_s = time.monotonic() + WAIT_S, 0.0005
        while True:
            try:
                return fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise busy(self.path.with_name("catalog.lock")) from None
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, 0.02)

    def _checkpoint(self) -> None:
        wal = self.path.with_name(f"{self.path.name}-wal")
        if wal.stat().st_size > WAL_PAGES * 4096:
            self._fault("checkpoint")
            self.db.execute("PRAGMA wal_checkpoint(PASSIVE)")

    def scrub(self) -> None:
        """Leave no byte of deleted rows in the file, its free pages or the WAL.

        Raises:
            StoreError: another process reads the catalog for over 10 s, or there is no space for a second copy.
        """
        with self.turn():
            try:
                self.db.execute("VACUUM")  # rows that were deleted before secure_delete was on have left pieces, too
                deadline = time.monotonic() + WAIT_S
                while self.db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
                    if time.monotonic() > deadline:
                        raise busy(self.path.with_name(f"{self.path.name}-wal"))
                    time.sleep(0.02)
            except sqlite3.Error as error:
                raise explain(error, self.path) from error

    def _prepare(self, migrations: tuple[str, ...]) -> None:
        with self.turn():
            self.db.execute("PRAGMA journal_mode=WAL")
            self.db.execute("PRAGMA synchronous=FULL")
            self.db.execute("PRAGMA foreign_keys=ON")
            self.db.execute("PRAGMA wal_autocheckpoint=0")
            self.db.execute("PRAGMA secure_delete=ON")  # what was forgotten does not stay in free pages
            self._refuse_strangers(len(migrations))
            (have,) = self.db.execute("PRAGMA user_version").fetchone()
            for number, script in enumerate(migrations[have:], have + 1):
                self._fault(f"migrate {number}")
                # one transaction: the schema and its number change together or not at all
                self.db.executescript(
                    f"BEGIN IMMEDIATE;{script};PRAGMA application_id={APPLICATION};PRAGMA user_version={number};COMMIT"
                )

    def _refuse_strangers(self, known: int) -> None:
        (application,) = self.db.execute("PRAGMA application_id").fetchone()
        (version,) = self.db.execute("PRAGMA user_version").fetchone()
        (tables,) = self.db.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        if tables and application != APPLICATION:
            raise StoreError(
                "catalog.db is not a Hardcase catalog", where=self.path, mend=f"name another folder: {ELSEWHERE}"
            )
        if version > known:
            raise StoreError(
                f"the store was written by a newer Hardcase (schema {version}, this one knows {known})",
                where=self.path,
                mend=f"update Hardcase (git pull && uv sync), or name another folder: {ELSEWHERE}",
            )
