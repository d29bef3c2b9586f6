"""Who caused whom: for each kind of thing, the queries that give its causes and its effects.

Every query takes ids as a JSON list and gives pairs; every one of them goes through an index.
"""

from types import MappingProxyType
from typing import Literal, NamedTuple

from pipeline.store.erasure_plan import NEAR
from pipeline.store.ingests import INGEST

type Thing = Literal["run", "consent", "raw_log", "conversion", "episode", "hard_case", "version", "policy", "verdict",
                     "release", "checked", "worth", "erased"]

IDS = "(SELECT value FROM json_each(?))"
_TRANSFORM, _CONSENT = "json_extract(episode.json, '$.transform')", "json_extract(episode.json, '$.consent')"
_BETWEEN = "SELECT correction FROM hard_case WHERE correction NOT NULL"
"""A correction that answers a hard case is told below it, not below the attempt."""


class Relation(NamedTuple):
    """One way from a kind of thing to another."""

    to: Thing
    sql: str
    """Pairs of an id that was asked about and one that it leads to."""


BACK: MappingProxyType[str, tuple[Relation, ...]] = MappingProxyType({
    "conversion": (Relation("raw_log", f"SELECT id, log FROM conversion WHERE id IN {IDS}"),),
    "episode": (
        Relation("hard_case", f"SELECT correction, id FROM hard_case WHERE correction IN {IDS}"),
        Relation("episode", f"SELECT id, parent FROM episode WHERE id IN {IDS} AND parent NOT NULL"
                            f" AND id NOT IN ({_BETWEEN})"),
        Relation("episode", f"SELECT id, substr({_TRANSFORM}, {len(NEAR) + 1}) FROM episode"
                            f" WHERE id IN {IDS} AND {_TRANSFORM} LIKE '{NEAR}%'"),
        Relation("policy", f"SELECT id, policy FROM episode WHERE id IN {IDS} AND policy NOT NULL AND parent IS NULL"),
        Relation("conversion", "SELECT episode.id, ingestion.conversion FROM episode JOIN ingestion ON ingestion.id ="
                               f" substr({_TRANSFORM}, {len(INGEST) + 1})"
                               f" WHERE episode.id IN {IDS} AND episode.origin = 'ingested'"),
        Relation("consent", f"SELECT episode.id, consent.id FROM episode JOIN consent ON consent.id = {_CONSENT}"
                            f" WHERE episode.id IN {IDS} AND parent IS NULL"),
    ),
    "hard_case": (Relation("episode", f"SELECT id, episode FROM hard_case WHERE id IN {IDS}"),),
    "version": (
        Relation("episode", f"SELECT version, episode FROM version_episode WHERE version IN {IDS}"),
        Relation("hard_case", "SELECT version.id, value FROM version, json_each(version.json, '$.starts')"
                              f" WHERE version.id IN {IDS}"),
        Relation("erased", f"SELECT version, episode FROM erased_version WHERE version IN {IDS}"),
        Relation("version", f"SELECT id, parent FROM version WHERE id IN {IDS} AND parent NOT NULL"),
    ),
    "policy": (Relation("version", f"SELECT id, dataset FROM policy WHERE id IN {IDS}"),),
    "verdict": (
        Relation("policy", f"SELECT id, candidate FROM verdict WHERE id IN {IDS}"),
        Relation("policy", f"SELECT id, json_extract(json, '$.champion') FROM verdict WHERE id IN {IDS}"
                           " AND json_extract(json, '$.champion') NOT NULL"),
    ),
    "release": (
        Relation("verdict", "SELECT run || ' ' || number, json_extract(json, '$.verdict') FROM release"
                            f" WHERE run || ' ' || number IN {IDS} AND json_extract(json, '$.verdict') NOT NULL"),
        Relation("policy", "SELECT run || ' ' || number, policy FROM release WHERE run || ' ' || number IN"
                           f" {IDS} AND json_extract(json, '$.verdict') IS NULL"),
    ),
    "worth": (Relation("version", f"SELECT id, version FROM worth WHERE id IN {IDS}"),),
    "checked": (
        Relation("episode", "SELECT checked.id, episode.id FROM checked JOIN episode ON episode.blob = subject"
                            f" WHERE checked.id IN {IDS}"),
        Relation("version", "SELECT checked.id, version.id FROM checked JOIN version ON version.id ="
                            " json_extract(checked.json, '$.name') AND json_extract(version.json, '$.digest') = subject"
                            f" WHERE checked.id IN {IDS}"),
        Relation("raw_log", "SELECT checked.id, raw_log.id FROM checked JOIN raw_log ON raw_log.id = subject"
                            f" WHERE checked.id IN {IDS}"),
    ),
})
"""Kind -> what its things came from."""

FORWARD: MappingProxyType[str, tuple[Relation, ...]] = MappingProxyType({
    "run": (Relation("episode", f"SELECT run, id FROM member WHERE run IN {IDS} AND kind = 'episode'"
                                " AND stage = 'collect'"),),
    "consent": (Relation("episode", f"SELECT {_CONSENT}, id FROM episode WHERE {_CONSENT} IN {IDS}"
                                    " AND parent IS NULL"),),
    "raw_log": (Relation("conversion", f"SELECT log, id FROM conversion WHERE log IN {IDS}"),),
    "conversion": (Relation("episode", "SELECT ingestion.conversion, episode.id FROM ingestion JOIN episode"
                                       f" ON {_TRANSFORM} = '{INGEST}' || ingestion.id"
                                       f" WHERE ingestion.conversion IN {IDS}"),),
    "episode": (
        Relation("episode", f"SELECT parent, id FROM episode WHERE parent IN {IDS} AND id NOT IN ({_BETWEEN})"),
        Relation("episode", f"SELECT substr({_TRANSFORM}, {len(NEAR) + 1}), id FROM episode WHERE {_TRANSFORM} IN"
                            f" (SELECT '{NEAR}' || value FROM json_each(?))"),
        Relation("hard_case", f"SELECT episode, id FROM hard_case WHERE episode IN {IDS}"),
        Relation("version", f"SELECT episode, version FROM version_episode WHERE episode IN {IDS}"),
    ),
    "hard_case": (Relation("episode", "SELECT id, correction FROM hard_case"
                                      f" WHERE id IN {IDS} AND correction NOT NULL"),
                  Relation("version", "SELECT hard_case.id, version.id FROM hard_case JOIN version_episode USING"
                                      " (episode) JOIN version ON version.id = version, json_each(version.json,"
                                      f" '$.starts') WHERE hard_case.id IN {IDS} AND value = hard_case.id")),
    "version": (
        Relation("policy", f"SELECT dataset, id FROM policy WHERE dataset IN {IDS}"),
        Relation("version", f"SELECT parent, id FROM version WHERE parent IN {IDS}"),
    ),
    "policy": (
        Relation("verdict", f"SELECT candidate, id FROM verdict WHERE candidate IN {IDS}"),
        Relation("release", f"SELECT policy, run || ' ' || number FROM release WHERE policy IN {IDS}"
                            " AND json_extract(json, '$.verdict') IS NULL"),
        Relation("episode", f"SELECT policy, id FROM episode WHERE policy IN {IDS} AND parent IS NULL"),
    ),
    "verdict": (Relation("release", "SELECT verdict.id, run || ' ' || number FROM verdict JOIN release ON"
                                    " release.policy = verdict.candidate AND json_extract(release.json, '$.verdict')"
                                    f" = verdict.id WHERE verdict.id IN {IDS}"),),
    "erased": (Relation("version", "SELECT erased.id, value FROM erased JOIN erasure ON erasure.id = erased.erasure,"
                                   f" json_each(erasure.json, '$.versions') WHERE erased.id IN {IDS}"),),
})
"""Kind -> what was made of its things, or used them."""
