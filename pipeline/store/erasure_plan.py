"""What goes with an episode: everything that holds frames of it, its start, or the log that it lies in."""

from collections.abc import Callable, Iterable
from datetime import datetime
from json import dumps

from pipeline.errors import StoreError
from pipeline.files import short_id
from pipeline.store.ingests import INGEST
from pipeline.store.reader import Reader
from schemas.episode import VARIANTS
from schemas.erasure import Erasure

NEAR = "retarget near "
"""How the `transform` of a variant begins that starts where another attempt did; the id of that attempt follows."""


def plan_erasure(store: Reader, id: str, reason: str, at: datetime, *, with_log: bool = False) -> Erasure:
    """Everything that `forget` would take away; nothing is touched.

    An episode goes with whatever was made from it: variants and corrections, through any number of steps, and
    variants that begin where it began. Of a foreign log everything goes, for the log holds it whole.

    Args:
        store: an open store.
        id: the episode, or 8 and more of its first digits.
        reason: why, for the tombstone.
        at: this moment, with its time zone.
        with_log: agree to lose the raw log that the episode lies in, with all other episodes of it.

    Raises:
        StoreError: no such episode, it is forgotten already, or it lies in a log and `with_log` was not given.
    """
    table, whole = store.find(id, f"hardcase forget {id}")
    if table == "erased":
        raise StoreError(f"{whole} was forgotten already", where=store.erased([whole])[whole].reason,
                         mend=f"see what went with it: hardcase why {whole}")
    if table != "episode":
        mend = "name one of its episodes"
        if table == "hard_case":
            mend = f"name its episode: hardcase forget {store.hard_case(whole).episode}"
        raise StoreError(f"{whole} is no episode but a {table.replace('_', ' ')}", where="hardcase forget", mend=mend)
    logs = _logs(store, [whole])
    if logs and not with_log:
        held = len(_everything(store, [whole]))
        raise StoreError(f"episode {whole} lies in a raw log; the log goes with it, and all {held} episodes made of it",
                         where=f"log {', '.join(logs)[:80]}", mend=f"agree to that: hardcase forget {whole} --with-log")
    return _listed(store, whole, reason, at)


def refuse_other_plan(store: Reader, erasure: Erasure) -> None:
    """Raise StoreError if something was added since that would go, too."""
    if _listed(store, erasure.episode, erasure.reason, erasure.at) != erasure:
        raise StoreError("the store has changed since this was planned", where=f"episode {erasure.episode}",
                         mend=f"look again at what would go: hardcase forget {erasure.episode}")


def _listed(store: Reader, whole: str, reason: str, at: datetime) -> Erasure:
    episodes = _everything(store, [whole])
    logs = _logs(store, episodes)
    conversions = _column(store, "SELECT id FROM conversion WHERE log IN (SELECT value FROM json_each(?))", logs)
    blobs, shards = _files(store, episodes, logs, conversions)
    versions = _column(store, "SELECT id FROM version WHERE id IN (SELECT version FROM version_episode"
                              " WHERE episode IN (SELECT value FROM json_each(?))) ORDER BY place", episodes)
    return Erasure(
        id=short_id("erasure", whole), episode=whole, reason=reason, at=at, episodes=tuple(episodes),
        hard_cases=tuple(_column(store, "SELECT id FROM hard_case WHERE episode IN (SELECT value FROM json_each(?))",
                                 episodes)),
        raw_logs=tuple(logs), conversions=tuple(conversions), blobs=tuple(blobs), shards=tuple(shards),
        versions=tuple(versions),
        policies=tuple(_column(store, "SELECT id FROM policy WHERE dataset IN (SELECT value FROM json_each(?))"
                                      " ORDER BY place", versions)),
        runs=tuple(_column(store, "SELECT DISTINCT run FROM member WHERE id IN (SELECT value FROM json_each(?))",
                           [*episodes, *versions])))


def _everything(store: Reader, ids: Iterable[str]) -> list[str]:
    """These episodes and all that goes with them, in the order of finding."""
    found, wave = dict.fromkeys(ids), list(ids)
    while wave:
        grown = [e for look in _KIN for e in look(store, wave)]
        wave = [e for e in dict.fromkeys(grown) if e not in found]
        found |= dict.fromkeys(wave)
    return list(found)


def _children(store: Reader, ids: list[str]) -> list[str]:
    return _column(store, "SELECT id FROM episode WHERE parent IN (SELECT value FROM json_each(?))", ids)


def _near(store: Reader, ids: list[str]) -> list[str]:
    return _column(store, "SELECT id FROM episode WHERE json_extract(json, '$.transform') IN"
                          " (SELECT value FROM json_each(?))", [NEAR + id for id in ids])


def _same_file(store: Reader, ids: list[str]) -> list[str]:
    """Episodes whose recording is the same file; shards of variants can be written without some of them."""
    return _column(store, "SELECT id FROM episode WHERE blob IN"
                          " (SELECT blob FROM episode WHERE id IN (SELECT value FROM json_each(?)))"
                          " AND origin NOT IN (SELECT value FROM json_each(?))", ids, dumps(VARIANTS))


def _same_log(store: Reader, ids: list[str]) -> list[str]:
    made = _column(store, "SELECT ingestion.id FROM ingestion JOIN conversion ON conversion.id = ingestion.conversion"
                          " WHERE log IN (SELECT value FROM json_each(?))", _logs(store, ids))
    return _column(store, "SELECT id FROM episode WHERE json_extract(json, '$.transform') IN"
                          " (SELECT value FROM json_each(?))", [INGEST + id for id in made])


_KIN: tuple[Callable[[Reader, list[str]], list[str]], ...] = (_children, _near, _same_file, _same_log)


def _logs(store: Reader, episodes: list[str]) -> list[str]:
    """The raw logs that episodes were made of, by hash."""
    return _column(store, f"SELECT DISTINCT conversion.log FROM episode JOIN ingestion ON ingestion.id ="
                          f" substr(json_extract(episode.json, '$.transform'), {len(INGEST) + 1})"
                          " JOIN conversion ON conversion.id = ingestion.conversion"
                          " WHERE episode.origin = 'ingested' AND episode.id IN (SELECT value FROM json_each(?))",
                   episodes)


def _files(store: Reader, episodes: list[str], logs: list[str], conversions: list[str]) -> tuple[list[str], list[str]]:
    """Blobs that go whole, and shards that keep variants of others."""
    held = _column(store, "SELECT DISTINCT blob FROM episode WHERE blob NOT NULL"
                          " AND id IN (SELECT value FROM json_each(?))", episodes)
    shards = _column(store, "SELECT DISTINCT blob FROM episode WHERE blob IN (SELECT value FROM json_each(?))"
                            " AND id NOT IN (SELECT value FROM json_each(?))", held, dumps(episodes))
    made = _column(store, "SELECT DISTINCT value FROM conversion, json_each(conversion.json, '$.files')"
                          " WHERE conversion.id IN (SELECT value FROM json_each(?))", conversions)
    others = _column(store, "SELECT DISTINCT value FROM conversion, json_each(conversion.json, '$.files')"
                            " WHERE conversion.id NOT IN (SELECT value FROM json_each(?))", conversions)
    stay = {*others, *shards}
    return list(dict.fromkeys(b for b in (*held, *logs, *made) if b not in stay)), shards


def _column(store: Reader, sql: str, ids: Iterable[str], *more: str) -> list[str]:
    """The first column of a query whose first parameter is a list of ids."""
    chosen = list(ids)
    return [str(value) for value, *_ in store.query(sql, (dumps(chosen), *more))] if chosen else []
