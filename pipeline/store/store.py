"""The store: what every stage reads from and commits to."""

from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Self

from pipeline.errors import StoreError
from pipeline.files import sha256_file
from pipeline.store import erasures
from pipeline.store import lease as leases
from pipeline.store.blobs import Blobs
from pipeline.store.catalog import Catalog
from pipeline.store.checks import add_check
from pipeline.store.consents import add_consent, revoke_consent
from pipeline.store.erasure_plan import refuse_other_plan
from pipeline.store.folder import (
    RESERVE_MB,
    FaultPoint,
    check_id,
    explain,
    inside,
    is_full,
    no_fault,
    refuse_low_space,
    refuse_network,
)
from pipeline.store.ingests import add_conversion, add_ingestion, add_raw_log
from pipeline.store.lease import Lease
from pipeline.store.process import Holder
from pipeline.store.reader import Reader
from pipeline.store.transaction import Transaction
from pipeline.store.versions import add_version
from pipeline.store.worths import add_worth
from schemas.consent import Consent
from schemas.conversion import Conversion, Ingestion, RawLog
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.erasure import Erasure
from schemas.finding import CheckVerdict
from schemas.worth import BatchWorth

WAITING = 8
"""Blobs written at once: the file system commits their fsyncs together."""


class Store(Reader):
    """A folder with a catalog (`catalog.db`), blobs, and the folders of dataset versions and policies.

    Threads may share a store; processes each open their own. Use it in a `with`, or close it.
    Every method raises StoreError.
    """

    def __init__(self, root: Path, *, reserve_mb: int = RESERVE_MB, fault: FaultPoint = no_fault) -> None:
        super().__init__(Catalog(root, fault))
        self.root, self._reserve_mb, self._fault = root, reserve_mb, fault
        self._blobs = Blobs(root, fault, self._refuse_forgotten)
        self._full: StoreError | None = None

    @classmethod
    def open(
        cls, root: Path, *, create: bool = False, reserve_mb: int = RESERVE_MB, fault: FaultPoint = no_fault
    ) -> Self:
        """Open a store, or make one.

        Args:
            root: its folder; see `store_root`.
            create: make it if it is not there, and refuse a disk with less than the reserve free.
            reserve_mb: space to keep free [MB]; a loop that takes the lease is refused below it.
            fault: for tests of crashes.

        Raises:
            StoreError: no store there, a network file system, a folder that cannot be written, too little space,
                another program's or a newer Hardcase's catalog.
        """
        try:
            if create:
                root.mkdir(parents=True, exist_ok=True)
            elif not (root / "catalog.db").is_file():
                raise StoreError(
                    "there is no store here",
                    where=root,
                    mend="begin one with `hardcase loop`, or name it: HARDCASE_STORE=/its/folder",
                )
            refuse_network(root)
            if create:
                refuse_low_space(root, reserve_mb)
            for name in ("blobs", "tmp", "versions", "policies"):
                (root / name).mkdir(exist_ok=True)
        except OSError as error:
            raise explain(error, root) from error
        return cls(root, reserve_mb=reserve_mb, fault=fault)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the catalog."""
        self._catalog.close()

    @property
    def tmp(self) -> Path:
        """Where to build what is then moved in whole; what stays there, gc takes away."""
        return self.root / "tmp"

    def path(self, relative: str) -> Path:
        """The place of a stored relative path, such as that of a version; refused outside the store."""
        return inside(self.root, relative)

    @contextmanager
    def lease(self, run: str, *, holder: str | None = None, term_s: float = leases.TERM_S,
              erases: bool = False) -> Generator[Lease]:
        """Be the one loop of this store while the body runs.

        Args:
            run: id of the run.
            holder: the command that a refused second loop is told; default: this process's command line.
            term_s: silence after which another loop may take over [s].
            erases: this is the one who may work while an erasure is to be finished.

        Raises:
            StoreError: another loop runs (named in the error), or less than the reserve is free.
        """
        refuse_low_space(self.root, self._reserve_mb)
        lease = leases.take(self._catalog, check_id("run", run), holder, term_s)
        try:
            if not erases:
                erasures.refuse_unfinished(self._catalog)
            with leases.heartbeat(lambda: Catalog(self.root), lease):
                yield lease
        finally:
            with suppress(StoreError):  # a full disk: our death frees it as well, and the body's own error says more
                leases.give_back(self._catalog, lease)

    def holder(self) -> Holder | None:
        """Who runs a loop on this store now."""
        return leases.holder(self._catalog)

    @contextmanager
    def commit(self, lease: Lease, run: str | None = None) -> Generator[Transaction]:
        """One transaction for the writes of one step; all of them last once this returns, none when it raises.

        Keep the body short, it holds the write lock: compute first, then commit.

        Args:
            lease: from `lease`; a stale one is refused.
            run: whose rows these are, where a control arm runs under the lease of its loop.
        """
        if self._full:
            raise self._full
        with self._latch(), self._catalog.write() as db:
            leases.renew(db, lease)
            tx = Transaction(db, self.root, self._blobs, run or lease.run, self._fault)
            yield tx
            try:
                tx.settle()
            except OSError as error:
                raise explain(error, self.root) from error

    def add_consent(self, consent: Consent) -> None:
        """Keep what a person consented to; it belongs to no run and needs no lease."""
        add_consent(self._catalog, consent)

    def revoke_consent(self, id: str, at: datetime) -> Consent:
        """Note that a person took their consent back at this moment; the record as it is from now on."""
        return revoke_consent(self._catalog, id, at)

    def add_check(self, verdict: CheckVerdict) -> None:
        """Keep what the checks found; it belongs to no run and needs no lease."""
        add_check(self._catalog, verdict)

    def add_worth(self, worth: BatchWorth) -> None:
        """Keep a verdict on a batch; it belongs to no run and needs no lease."""
        add_worth(self._catalog, worth)

    def add_raw_log(self, log: RawLog) -> None:
        """Note a foreign log whose bytes are a blob already; like all of its kind it needs no lease."""
        add_raw_log(self._catalog, self._blobs, log)

    def add_conversion(self, conversion: Conversion) -> None:
        """Note what was made of a foreign log, or why nothing was."""
        add_conversion(self._catalog, self._blobs, conversion)

    def add_ingestion(self, ingestion: Ingestion, episodes: Sequence[Episode]) -> None:
        """Note what a map says about a conversion, and the episodes that follow from both."""
        add_ingestion(self._catalog, ingestion, episodes)

    def add_version(self, version: DatasetVersion, episodes: Sequence[Episode] = ()) -> None:
        """Note a dataset version that belongs to no run, and the episodes that came with it; it needs no lease."""
        add_version(self._catalog, self._blobs, version, episodes)

    def order_erasure(self, lease: Lease, erasure: Erasure) -> None:
        """Write down what will be forgotten; from now on none of it comes back, and no loop starts before the end."""
        with self._catalog.write() as db:
            leases.renew(db, lease)
            refuse_other_plan(self, erasure)
            erasures.order(db, erasure)

    def strike(self, lease: Lease, erasure: Erasure, shards: Mapping[str, str],
               versions: Sequence[DatasetVersion]) -> None:
        """Take the rows of an erasure away; `shards` and `versions` say what became of files that others share."""
        with self._catalog.write() as db:
            leases.renew(db, lease)
            self._blobs.settle(shards.values())
            erasures.strike(db, erasure, shards, versions)

    def finish_erasure(self, lease: Lease, erasure: Erasure) -> None:
        """Note that nothing is left of it, after the catalog itself was cleaned."""
        self._catalog.scrub()
        with self._catalog.write() as db:
            leases.renew(db, lease)
            erasures.finish(db, erasure)

    def unfinished_erasures(self) -> list[Erasure]:
        """Erasures that were ordered and cut off."""
        return erasures.unfinished(self._catalog)

    def erase_blob(self, sha: str) -> int:
        """Take a blob away that no row mentions any more; its size [B]."""
        return self._blobs.erase(sha)

    def _refuse_forgotten(self, sha: str) -> None:
        if gone := self.erased([sha]):
            raise erasures.forgotten(sha[:12], "what has the hash", gone[sha])

    @contextmanager
    def exclusive(self) -> Generator[None]:
        """Keep every commit of every process out while the body runs; gc deletes in it."""
        with self._catalog.turn():
            yield

    def put_blob(self, source: bytes | Path, *, move: bool = False) -> str:
        """Store bytes, or a file (`move`: take the file itself), and name them by their sha256."""
        with self._latch():
            return self._blobs.put(source, move=move)

    def put_blobs(self, sources: Iterable[bytes | Path], *, move: bool = False) -> list[str]:
        """Store many at once, their waits for the disk side by side; sha256s in the order of the sources."""
        with self._latch(), ThreadPoolExecutor(WAITING) as pool:
            return list(pool.map(partial(self._blobs.put, move=move), sources))

    @contextmanager
    def _latch(self) -> Generator[None]:
        """A write that failed for want of space ends this store's commits: no step with a hole is ever finished."""
        try:
            yield
        except StoreError as error:
            if isinstance(error.__cause__, OSError) and is_full(error.__cause__):
                self._full = error
            raise

    def blob(self, sha: str) -> Path:
        """The read-only file of a blob."""
        return self._blobs.get(sha)

    def verify(self) -> list[StoreError]:
        """Read every blob and policy file that the catalog speaks of; one error for each that changed."""
        damage: list[StoreError] = []
        for (sha,) in self.query("SELECT blob FROM episode WHERE blob NOT NULL UNION SELECT blob FROM version_input"
                                 " UNION SELECT id FROM raw_log UNION SELECT value FROM conversion,"
                                 " json_each(conversion.json, '$.files')"):
            try:
                self._blobs.verify(str(sha))
            except StoreError as error:
                damage.append(error)
        for policy in self.policies():
            for name, sha in policy.files.items():
                file = self.path(policy.checkpoint) / name
                if not file.is_file() or sha256_file(file) != sha:
                    damage.append(
                        StoreError(f"policy {policy.id} is damaged", where=file, mend="train it again in another store")
                    )
        return damage
