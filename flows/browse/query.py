"""What `hardcase browse` is asked for: a version, an episode, or a filter over all episodes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from pipeline.errors import ConfigError
from pipeline.query import Fields, parse
from pipeline.store import Store
from schemas.episode import Episode

FIELDS: Fields = {
    "outcome": "text", "success": "text", "source": "text", "family": "text", "trigger": "text", "task": "text",
    "robot": "text", "start": "text", "policy": "text", "parent": "text", "generation": "number", "frames": "number",
}
"""What episodes are asked by."""
PLACES: Mapping[str, str] = {
    "outcome": "label", "success": "CASE label WHEN 'success' THEN 'true' WHEN 'failure' THEN 'false' END",
    "source": "origin", "family": "json_extract(json, '$.outcome.family')",
    "trigger": "json_extract(json, '$.outcome.trigger')", "task": "json_extract(json, '$.scene.task')",
    "robot": "json_extract(json, '$.scene.robot')", "start": "stratum", "policy": "policy", "parent": "parent",
    "generation": "generation", "frames": "json_extract(json, '$.frames')",
}
"""Field -> where it stands in the catalog."""
_WORD = re.compile(r"([^=<>!\s]+)=([^=].*)")
_ID = re.compile(r"[0-9a-f]{8,16}")


@dataclass(frozen=True, slots=True)
class Chosen:
    """The episodes that were asked for, oldest first."""

    title: str
    episodes: tuple[Episode, ...]
    single: bool = False
    """One episode was named: it is opened at once."""
    more: int = 0
    """Episodes that match and are beyond the limit."""


def choose(store: Store, words: Sequence[str], limit: int) -> Chosen:
    """Find what was asked for.

    Args:
        store: where to look.
        words: nothing for everything; the id of a version, episode, hard case, policy or run; or a filter as
            'outcome=failure generation=2', or one in the grammar of pipeline.query.
        limit: episodes at most; the newest.

    Raises:
        StoreError: no such id.
        ConfigError: a field that is not known, a value of the wrong kind, or nothing matches.
    """
    if len(words) == 1 and _ID.fullmatch(words[0]):
        return _by_id(store, words[0], limit)
    where, values = "true", ()
    text = " ".join(words)
    if words:
        where, values = parse(_spelt(store, words), FIELDS).sql(PLACES)
    ids = [str(i) for (i,) in store.query(f"SELECT id FROM episode WHERE {where} ORDER BY place", tuple(values))]
    if not ids:
        raise _nothing(store, words)
    return _limited(store, text or "all episodes", ids, limit)


def _by_id(store: Store, prefix: str, limit: int) -> Chosen:
    table, id = store.find(prefix)
    if table == "episode":
        return Chosen(f"episode {id}", (store.episode(id),), single=True)
    if table == "hard_case":
        case = store.hard_case(id)
        ids = [case.episode, *([case.correction] if case.correction else [])]
        return Chosen(f"hard case {id}", tuple(store.episodes(ids)))
    if table == "version":
        return _limited(store, f"version {id}", list(store.version(id).episodes), limit)
    if table == "policy":
        ids = [e.id for e in store.episodes(policy=id)]
    elif table == "run":
        ids = [e.id for e in store.episodes(run=id)]
    else:
        raise ConfigError(f"{id} is a {table.replace('_', ' ')}: there is nothing to look at", where=f"browse {prefix}",
                          mend="name an episode, a hard case, a dataset version, a policy or a run")
    if not ids:
        raise ConfigError(f"{table} {id} has no episodes", where=f"browse {prefix}",
                          mend=f"see what is known of it: hardcase why {id}")
    return _limited(store, f"{table} {id}", ids, limit)


def _limited(store: Store, title: str, ids: list[str], limit: int) -> Chosen:
    return Chosen(title, tuple(store.episodes(ids[-limit:])), more=max(len(ids) - limit, 0))


def _spelt(store: Store, words: Sequence[str]) -> str:
    """The filter in the grammar of pipeline.query; FIELD=VALUE words are joined by and."""
    pairs = [_WORD.fullmatch(word) for word in words]
    if not all(pairs):
        return " ".join(words)
    found: list[str] = []
    for pair in pairs:
        assert pair is not None
        field, value = pair[1], pair[2]
        if field not in FIELDS:
            near = get_close_matches(field, FIELDS, n=1)
            hint = f"do you mean {near[0]}? " if near else ""
            raise ConfigError(f"unknown field {field!r}", where=" ".join(words),
                              mend=f"{hint}use one of: {', '.join(sorted(FIELDS))}")
        if field in ("policy", "parent") and _ID.fullmatch(value):
            value = store.find(value)[1]
        found.append(f'{field} == "{value.replace(chr(34), "")}"')
    return " and ".join(found)


def _nothing(store: Store, words: Sequence[str]) -> ConfigError:
    """The error for a filter that nothing matches: it lists what there is of the fields that were asked."""
    if not words:
        return ConfigError("the store holds no episodes yet", where=store.root, mend="begin with: hardcase loop")
    asked = [f for f in FIELDS if any(re.search(rf"\b{f}\b", word) for word in words)]
    listed = "; ".join(f"{field}: {_values(store, field)}" for field in asked)
    return ConfigError("no episode matches", where=" ".join(words), mend=f"there are {listed}")


def _values(store: Store, field: str) -> str:
    place = PLACES[field]
    rows = store.query(f"SELECT {place}, count(*) FROM episode GROUP BY 1 ORDER BY 2 DESC LIMIT 12")
    return ", ".join(f"{'none' if value is None else value} ({count})" for value, count in rows)
