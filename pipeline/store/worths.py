"""Verdicts on batches in the catalog: written at any time, also while a loop runs; the last one on a batch counts."""

from pipeline.store.catalog import Catalog
from schemas.worth import BatchWorth

_LAST = "place IN (SELECT max(place) FROM worth GROUP BY batch)"


def add_worth(catalog: Catalog, worth: BatchWorth) -> None:
    """Keep a verdict; one that is given again becomes the last one on its batch."""
    with catalog.write() as db:
        db.execute("DELETE FROM worth WHERE id = ?", (worth.id,))
        db.execute("INSERT INTO worth (id, version, batch, decision, json) VALUES (?, ?, ?, ?, ?)",
                   (worth.id, worth.version, worth.batch, worth.decision, worth.model_dump_json()))


def worths(catalog: Catalog, *, last: bool = True) -> list[BatchWorth]:
    """The last verdict on every batch, or every verdict, oldest first."""
    rows = catalog.rows(f"SELECT json FROM worth WHERE {_LAST if last else 'true'} ORDER BY place")
    return [BatchWorth.model_validate_json(str(text)) for (text,) in rows]


def hurting(catalog: Catalog) -> list[BatchWorth]:
    """The last verdicts that are HURTS, oldest first."""
    rows = catalog.rows(f"SELECT json FROM worth WHERE {_LAST} AND decision = 'HURTS' ORDER BY place")
    return [BatchWorth.model_validate_json(str(text)) for (text,) in rows]
