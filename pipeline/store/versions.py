"""Dataset versions that belong to no run: derived, imported, or built from foreign logs."""

from collections.abc import Iterable

from pipeline.errors import StoreError
from pipeline.store.blobs import Blobs
from pipeline.store.catalog import Catalog
from pipeline.store.folder import inside
from pipeline.store.rows import insert, require, require_all
from schemas.dataset import DatasetVersion
from schemas.episode import Episode


def add_version(catalog: Catalog, blobs: Blobs, version: DatasetVersion, episodes: Iterable[Episode] = ()) -> None:
    """Note a version whose folder lies in the store, sealed, and the episodes that came with it.

    Raises:
        StoreError: its parent or an episode is not in the store, or something else has its id.
    """
    where = f"version {version.id}"
    with catalog.write() as db:
        if not inside(catalog.path.parent, version.path).is_dir():
            raise StoreError(f"folder {version.path} is not in the store", where=where,
                             mend="write the folder before its row: derive, import or build it again")
        for e in episodes:
            insert(db, "episode", e, ("id",), {
                "id": e.id, "origin": e.origin, "generation": e.generation, "label": e.outcome.label,
                "stratum": e.scene.stratum, "parent": e.parent, "policy": e.policy, "blob": e.blob})
        if version.parent:
            require(db, "version", version.parent, f"parent of {where}")
        require_all(db, "episode", version.episodes, where)
        blobs.settle(version.inputs)
        insert(db, "version", version, ("id",), {"id": version.id, "parent": version.parent,
                                                 "generation": version.generation})
        for table, ids in (("version_episode", version.episodes), ("version_input", version.inputs)):
            db.executemany(f"INSERT OR IGNORE INTO {table} VALUES (?, ?)", [(version.id, id) for id in ids])
