"""Consent records for people at a terminal, and the clock that the doors to training are asked by."""

import json
from datetime import UTC, date, datetime
from typing import Any

from pydantic import ValidationError

from pipeline.consent import Consents
from pipeline.errors import ConfigError
from pipeline.files import short_id
from pipeline.store import Store, store_root
from pipeline.store.reader import Reader
from schemas.consent import Consent


def consents_now(store: Reader) -> Consents:
    """The consent records of a store, for a use at this moment."""
    return Consents(store.consents(), datetime.now(UTC))


def add(operator: str, site: str, purposes: tuple[str, ...], given: str | None, expires: str,
        id: str | None) -> Consent:
    """Keep a new record in the store, which is made if it is not there.

    Args:
        operator: pseudonym.
        site: where it is recorded.
        purposes: training, evaluation, review.
        given: first day, YYYY-MM-DD; None is today [UTC].
        expires: last day, YYYY-MM-DD.
        id: number of the form; None makes one from what the record says.

    Raises:
        ConfigError: a value that breaks a rule; names the option.
        StoreError: another record has this id, or the store cannot be used.
    """
    first = _day(given, "--given") if given else datetime.now(UTC).date()
    values = {"operator": operator, "site": site, "purposes": tuple(dict.fromkeys(purposes)), "given": first,
              "expires": _day(expires, "--expires")}
    try:
        record = Consent.model_validate({"id": id or short_id("consent", *values.values()), **values})
    except ValidationError as error:
        raise _broken(error) from None
    with Store.open(store_root(), create=True) as store:
        store.add_consent(record)
    return record


_NAME = "use 1 to 64 of a-z, 0-9, _ and -, and a pseudonym, never a person's name"
_MENDS = {
    "id": "use 1 to 64 of a-z, 0-9, _ and -, such as form-12; 'simulated' and 'none' are taken",
    "operator": _NAME, "site": _NAME, "purpose": "use one or more of: training, evaluation, review",
    "expires": "give a last day that is not before the first: --given YYYY-MM-DD --expires YYYY-MM-DD",
}


def _broken(error: ValidationError) -> ConfigError:
    """The first rule that a record breaks, by the option that says it; a rule on both days speaks of the last."""
    fault = error.errors()[0]
    option = {"purposes": "purpose"}.get(field := str((*fault["loc"], "expires")[0]), field)
    return ConfigError(f"a consent cannot say this: {fault['msg'].removeprefix('Value error, ')}",
                       where=f"--{option} {fault['input']}" if fault["loc"] else f"--{option}", mend=_MENDS[option])


def _day(text: str, option: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise ConfigError(f"{text!r} is no day", where=option, mend=f"write it so: {option} 2027-12-31") from None


def every() -> list[dict[str, Any]]:
    """All records of the store with their state, in the order of adding."""
    with Store.open(store_root()) as store:
        return [_told(store, record) for record in store.consents().values()]


def one(id: str) -> dict[str, Any]:
    """A record with its state, the episodes that name it, and the versions and policies that hold them.

    Raises:
        StoreError: there is no such record, or no store.
    """
    with Store.open(store_root()) as store:
        return _told(store, store.consent(id)) | _use(store, id)


def revoke(id: str) -> dict[str, Any]:
    """Note that the person took it back now; returns what `one` returns.

    Raises:
        StoreError: there is no such record, or no store.
    """
    with Store.open(store_root()) as store:
        record = store.revoke_consent(id, datetime.now(UTC))
        return _told(store, record) | _use(store, id)


def _told(store: Reader, record: Consent) -> dict[str, Any]:
    flaw = consents_now(store).ends(record)
    return json.loads(record.model_dump_json()) | {"holds": flaw is None, "reason": flaw.reason if flaw else ""}


def _use(store: Reader, id: str) -> dict[str, Any]:
    """What was made under a record, descendants of its episodes included."""
    made = ("WITH RECURSIVE made (id) AS (SELECT id FROM episode WHERE json_extract(json, '$.consent') = ?"
            " UNION SELECT episode.id FROM episode JOIN made ON episode.parent = made.id) ")
    asked = {
        "episodes": "SELECT id FROM made",
        "versions": "SELECT DISTINCT version FROM version_episode WHERE episode IN made",
        "policies": "SELECT id FROM policy WHERE dataset IN (SELECT version FROM version_episode"
                    " WHERE episode IN made)",
    }
    return {name: [str(i) for (i,) in store.query(made + sql + " ORDER BY 1", (id,))] for name, sql in asked.items()}


def render(record: dict[str, Any]) -> str:
    """A record in a few lines."""
    state = "holds" if record["holds"] else f"does not hold: {record['reason']}"
    lines = [f"consent {record['id']}: {state}", f"  operator: {record['operator']} at {record['site']}",
             f"  for: {', '.join(record['purposes'])}", f"  from {record['given']} to {record['expires']}"]
    for kind in ("episodes", "versions", "policies"):
        if kind in record:
            ids = record[kind]
            lines.append(f"  {kind}: {', '.join(ids[:3]) or 'none'}" + (f" and {len(ids) - 3} more" * (len(ids) > 3)))
    return "\n".join(lines)
