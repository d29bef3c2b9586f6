"""Foreign logs in the catalog: what came, what was made of it, and what was said about it. They belong to no run."""

from collections.abc import Sequence

from pipeline.errors import StoreError
from pipeline.store.blobs import Blobs
from pipeline.store.catalog import Catalog
from pipeline.store.erasures import refuse_forgotten
from pipeline.store.rows import insert, require
from schemas.conversion import Conversion, Ingestion, RawLog
from schemas.episode import Episode

INGEST = "ingest "
"""How the `transform` of an ingested episode begins; the id of its Ingestion follows."""


def add_raw_log(catalog: Catalog, blobs: Blobs, log: RawLog) -> None:
    """Note a log whose bytes lie in the store; where it first came from stays."""
    with catalog.write() as db:
        if db.execute("SELECT 1 FROM raw_log WHERE id = ?", (log.id,)).fetchone() is None:
            blobs.settle([log.id])
            insert(db, "raw_log", log, ("id",), {"id": log.id})


def add_conversion(catalog: Catalog, blobs: Blobs, conversion: Conversion) -> None:
    """Note what was made of a log; its files lie in the store.

    Raises:
        StoreError: its log is not known, or something else has its id.
    """
    with catalog.write() as db:
        if db.execute("SELECT 1 FROM raw_log WHERE id = ?", (conversion.log,)).fetchone() is None:
            raise StoreError(f"log {conversion.log[:12]} is not in the store", where=f"conversion {conversion.id}",
                             mend="store the log first")
        refuse_forgotten(db, "log", [conversion.log])
        blobs.settle(sorted(conversion.files.values()))
        insert(db, "conversion", conversion, ("id",),
               {"id": conversion.id, "log": conversion.log, "state": conversion.state})


def add_ingestion(catalog: Catalog, ingestion: Ingestion, episodes: Sequence[Episode]) -> None:
    """Note what a map says about a conversion, and the episodes that follow; an equal one changes nothing."""
    with catalog.write() as db:
        require(db, "conversion", ingestion.conversion, f"ingestion {ingestion.id}")
        refuse_forgotten(db, "conversion", [ingestion.conversion])
        insert(db, "ingestion", ingestion, ("id",), {"id": ingestion.id, "conversion": ingestion.conversion})
        for e in episodes:
            insert(db, "episode", e, ("id",), {
                "id": e.id, "origin": e.origin, "generation": e.generation, "label": e.outcome.label,
                "stratum": e.scene.stratum, "parent": e.parent, "policy": e.policy, "blob": e.blob})


def raw_log(catalog: Catalog, id: str) -> RawLog | None:
    """A log by its hash, or None."""
    rows = catalog.rows("SELECT json FROM raw_log WHERE id = ?", (id,))
    return RawLog.model_validate_json(str(rows[0][0])) if rows else None


def conversion(catalog: Catalog, id: str) -> Conversion | None:
    """A conversion, or None where there is none yet."""
    rows = catalog.rows("SELECT json FROM conversion WHERE id = ?", (id,))
    return Conversion.model_validate_json(str(rows[0][0])) if rows else None


def conversions(catalog: Catalog, log: str) -> list[Conversion]:
    """Everything that was ever made of a log, oldest first."""
    rows = catalog.rows("SELECT json FROM conversion WHERE log = ? ORDER BY place", (log,))
    return [Conversion.model_validate_json(str(text)) for (text,) in rows]


def ingestion_of(catalog: Catalog, episode: Episode) -> Ingestion | None:
    """What made an ingested episode; None for any other."""
    if episode.transform is None or not episode.transform.startswith(INGEST):
        return None
    rows = catalog.rows("SELECT json FROM ingestion WHERE id = ?", (episode.transform.removeprefix(INGEST),))
    return Ingestion.model_validate_json(str(rows[0][0])) if rows else None
