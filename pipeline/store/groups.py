"""Many episodes told together: counts, ranges and first ids, from their records as they lie in the catalog.

Records are read as plain JSON and not checked again: of 100,000 episodes that would take ten times as long.
"""

from collections import Counter
from collections.abc import Sequence
from json import dumps
from typing import Any

import orjson

from pipeline.store.facts import codes, foreign_of, some, unit_of
from pipeline.store.ingests import INGEST
from pipeline.store.reader import Reader

type Record = dict[str, Any]
"""An episode as JSON."""


def records(store: Reader, ids: Sequence[str]) -> list[Record]:
    """The records of some episodes, in the order of the ids."""
    rows = store.query("SELECT id, json FROM episode WHERE id IN (SELECT value FROM json_each(?))", (dumps(ids),))
    texts = {str(id): str(text) for id, text in rows}
    return [orjson.loads(texts[id]) for id in ids]


def group_facts(store: Reader, episodes: Sequence[Record], full: bool) -> dict[str, str]:
    """What is known of episodes of one origin, in the order of telling."""
    seeds = [e["scene"]["seed"] for e in episodes]
    parents = list(dict.fromkeys(e["parent"] for e in episodes if e["parent"]))
    families = sorted({e["scene"]["family"] for e in episodes})
    strata = Counter(e["scene"]["stratum"] for e in episodes).most_common()
    facts = {
        "episodes": f"{len(episodes)}, {sum(e['frames'] for e in episodes)} frames",
        "strata": ", ".join(f"{name} {n}" for name, n in strata),
        "seeds": f"{min(seeds)} to {max(seeds)} ({', '.join(families)})",
    }
    if draws := _draws(episodes):
        facts["draws"] = draws
    transforms = sorted({e["transform"] for e in episodes if e["transform"]})
    if transforms:
        facts["made by"] = some(transforms, full)
    if actors := sorted({e["policy"] for e in episodes if e["policy"]}):
        facts["acted"] = ", ".join(f"policy {id}" for id in actors)
    if parents:
        facts["parents"] = f"{len(parents)}: {some(parents, full)}"
    facts |= foreign_of(store, [t.removeprefix(INGEST) for t in transforms if t.startswith(INGEST)], full)
    if code := codes(store, [e["id"] for e in episodes]):
        facts["code"] = code
    of_parents = [str(b) for (b,) in store.query(
        "SELECT blob FROM episode WHERE blob NOT NULL AND id IN (SELECT value FROM json_each(?))", (dumps(parents),))]
    if blobs := list(dict.fromkeys([*(e["blob"] for e in episodes if e["blob"]), *of_parents])):
        facts["recordings"] = f"{len(blobs)}: {some([b if full else b[:12] for b in blobs], full)}"
    return facts


def _draws(episodes: Sequence[Record]) -> str:
    """Smallest and largest value of every randomization, with its unit."""
    values: dict[tuple[str, str], list[float]] = {}
    for e in episodes:
        for d in e["scene"]["draws"]:
            values.setdefault((d["name"], d["unit"]), []).append(d["value"])
    return ", ".join(f"{name} {min(v):.4g} to {max(v):.4g}{unit_of(unit)}" for (name, unit), v in values.items())
