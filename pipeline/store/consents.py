"""Consent records in the catalog: added and revoked by people at any time, also while a loop runs."""

from datetime import datetime
from json import dumps

from pipeline.errors import StoreError
from pipeline.store.catalog import Catalog
from pipeline.store.rows import insert
from schemas.consent import Consent

MORE = "see them: hardcase consent list"


def add_consent(catalog: Catalog, consent: Consent) -> None:
    """Keep a record; an equal one that is there is left alone.

    Raises:
        StoreError: another record has this id, or it was revoked before: what is stored never changes.
    """
    if consent.revoked is not None:
        raise StoreError("a new consent is not revoked yet", where=f"consent {consent.id}",
                         mend=f"add it, then: hardcase consent revoke {consent.id}")
    with catalog.write() as db:
        if db.execute("SELECT 1 FROM consent_end WHERE consent = ?", (consent.id,)).fetchone():
            raise StoreError(f"consent {consent.id} was revoked", where=catalog.path.parent,
                             mend="a person who consents anew gets a new record: hardcase consent add --id NEW ...")
        insert(db, "consent", consent, ("id",), {"id": consent.id, "operator": consent.operator, "site": consent.site,
                                                 "expires": consent.expires.isoformat()})


def revoke_consent(catalog: Catalog, id: str, at: datetime) -> Consent:
    """Note that a person took their consent back; the first time counts, and nothing takes it back again.

    Args:
        catalog: where the record is.
        id: the record.
        at: the moment, with its time zone.

    Raises:
        StoreError: there is no such record.
    """
    with catalog.write() as db:
        if db.execute("SELECT 1 FROM consent WHERE id = ?", (id,)).fetchone() is None:
            raise unknown_consent(catalog, id)
        db.execute("INSERT OR IGNORE INTO consent_end (consent, json) VALUES (?, ?)",
                   (id, dumps({"revoked": at.isoformat()})))
    return consents(catalog)[id]


def consents(catalog: Catalog) -> dict[str, Consent]:
    """Id -> record, revocations included, in the order of adding."""
    rows = catalog.rows(
        "SELECT json_patch(consent.json, coalesce(consent_end.json, '{}')) FROM consent"
        " LEFT JOIN consent_end ON consent_end.consent = consent.id ORDER BY consent.place"
    )
    records = [Consent.model_validate_json(str(text)) for (text,) in rows]
    return {record.id: record for record in records}


def unknown_consent(catalog: Catalog, id: str) -> StoreError:
    """The error for a record that is not there: it lists those that are."""
    known = ", ".join(str(i) for (i,) in catalog.rows("SELECT id FROM consent ORDER BY place DESC LIMIT 5"))
    return StoreError(f"consent {id} is not in the store", where=catalog.path.parent,
                      mend=f"use one of: {known}" if known else "there is none yet: hardcase consent add")
