"""Verdicts of checks in the catalog: written at any time, also while a loop runs; the last one on a subject counts."""

from collections.abc import Iterable
from json import dumps

from pipeline.store.catalog import Catalog
from schemas.finding import CheckVerdict


def add_check(catalog: Catalog, verdict: CheckVerdict) -> None:
    """Keep a verdict; one that is given again becomes the last one on its subject."""
    with catalog.write() as db:
        db.execute("DELETE FROM checked WHERE id = ?", (verdict.id,))
        db.execute("INSERT INTO checked (id, subject, passed, contract, code, json) VALUES (?, ?, ?, ?, ?, ?)",
                   (verdict.id, verdict.subject, int(verdict.passed), verdict.contract, verdict.code,
                    verdict.model_dump_json()))


def checks_of(catalog: Catalog, subjects: Iterable[str]) -> dict[str, CheckVerdict]:
    """Hash of a recording or dataset -> the last verdict on it; those that were never checked are left out."""
    rows = catalog.rows(
        "SELECT json FROM checked WHERE place IN (SELECT max(place) FROM checked"
        " WHERE subject IN (SELECT value FROM json_each(?)) GROUP BY subject)", (dumps(list(subjects)),))
    verdicts = [CheckVerdict.model_validate_json(str(text)) for (text,) in rows]
    return {v.subject: v for v in verdicts}


def check_history(catalog: Catalog, subject: str) -> list[CheckVerdict]:
    """Every verdict on one subject, the last one last."""
    rows = catalog.rows("SELECT json FROM checked WHERE subject = ? ORDER BY place", (subject,))
    return [CheckVerdict.model_validate_json(str(text)) for (text,) in rows]
