"""What the loop remembers: a SQLite catalog, content-addressed blobs, one lease, and the way back from any id."""

from pipeline.store.folder import store_root
from pipeline.store.lease import Lease
from pipeline.store.records import RunInfo, StepManifest
from pipeline.store.store import Store
from pipeline.store.transaction import Transaction

__all__ = ["Lease", "RunInfo", "StepManifest", "Store", "Transaction", "store_root"]
