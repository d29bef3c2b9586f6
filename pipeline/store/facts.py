"""Single facts of a lineage, as text."""

from collections.abc import Sequence
from json import dumps

from pipeline.store.reader import Reader
from schemas.conversion import Ingestion
from schemas.episode import Episode

FIRST = 3
"""Ids that a summary shows of a group."""


def made(store: Reader, kind: str, id: str) -> dict[str, str]:
    """The step that added a row, and its code."""
    rows = store.query(
        "SELECT run, generation, stage FROM member WHERE kind = ? AND id = ? AND stage NOT NULL", (kind, id)
    )
    for run, generation, stage in rows:
        step = store.step(str(run), int(str(generation)), str(stage))
        if step:
            code = f", code {step.code}" if step.code else ""
            return {"step": f"{step.stage} of generation {step.generation}{code}"}
    return {}


def checked(store: Reader, subject: str | None) -> dict[str, str]:
    """The last verdict of the checks on a recording or dataset, by which contract and code."""
    verdict = store.checks([subject]).get(subject) if subject else None
    if verdict is None:
        return {}
    told = "passed" if verdict.passed else f"FAILED: {verdict.reason}"
    by = f"{len(verdict.checks)} checks, contract {verdict.contract[:12]}, code {verdict.code[:12]}"
    return {"check": f"{told}; {by}"}


def worth_of(store: Reader, episodes: Sequence[str]) -> dict[str, str]:
    """What was found of the batches that have an episode among these; the last verdict on each."""
    held = set(episodes)
    found = [w for w in store.worths() if not held.isdisjoint(w.episodes)]
    told = [f"{w.id} {w.decision}: {w.says}, {w.reason}" for w in found]
    kept_out = "; what hurts is kept out of later versions" if any(w.hurts for w in found) else ""
    return {"worth": some(told, full=True) + kept_out} if told else {}


def foreign_of(store: Reader, ingestions: Sequence[str], full: bool) -> dict[str, str]:
    """Where ingested episodes come from: the raw logs by hash, the maps, what was said of them, and the code."""
    rows = store.query("SELECT json FROM ingestion WHERE id IN (SELECT value FROM json_each(?)) ORDER BY place",
                       (dumps(list(ingestions)),)) if ingestions else []
    found = [Ingestion.model_validate_json(str(text)) for (text,) in rows]
    if not found:
        return {}
    made_by = [c for i in found if (c := store.conversion(i.conversion)) is not None]
    logs = [log for c in made_by if (log := store.raw_log(c.log)) is not None]
    told = {
        "logs": [f"{log.id if full or len(logs) == 1 else log.id[:12]} ({log.source}, {log.size_bytes} B)"
                 for log in logs],
        "maps": [f"{i.declared.name} (robot {i.declared.robot}, operator {i.declared.operator or 'not told'}, "
                 f"site {i.declared.site or 'not told'})" for i in found],
        "conversions": [f"{c.id} (code {c.code if full else c.code[:12]})" for c in made_by],
    }
    return {name: some(list(dict.fromkeys(lines)), full) for name, lines in told.items()}


def lost(store: Reader, version: str, name: str) -> dict[str, str]:
    """Episodes that a version held until they were forgotten."""
    gone = store.erased_in(version)
    if not gone:
        return {}
    why = list(dict.fromkeys(f"{e.at.date()}: {e.reason}" for e in gone.values()))
    return {name: f"erased {len(gone)} episodes ({'; '.join(why)}): {some(list(gone), full=False)}"}


def codes(store: Reader, ids: list[str]) -> str:
    """Code hashes of the steps that added some episodes, by stage and generation."""
    rows = store.query(
        "SELECT DISTINCT step.generation, step.stage, json_extract(step.json, '$.code') FROM member JOIN step"
        " ON (step.run, step.generation, step.stage) = (member.run, member.generation, member.stage)"
        " WHERE member.kind = 'episode' AND member.id IN (SELECT value FROM json_each(?)) ORDER BY 1, 2",
        (dumps(ids),),
    )
    return ", ".join(f"{stage} of generation {generation} {code}" for generation, stage, code in rows if code)


def users(store: Reader, id: str, full: bool) -> dict[str, str]:
    """Forward: the dataset versions that hold an episode, and the policies that saw it."""
    rows = store.query(
        "SELECT version.id, policy.id FROM version_episode JOIN version ON version.id = version_episode.version"
        " LEFT JOIN policy ON policy.dataset = version.id WHERE episode = ? ORDER BY version.place, policy.place",
        (id,),
    )
    versions = list(dict.fromkeys(str(v) for v, _ in rows))
    policies = [str(p) for _, p in rows if p]
    return {"in versions": some(versions, full) or "none", "seen by policies": some(policies, full) or "none"}


def releases(store: Reader, policy: str) -> dict[str, str]:
    """When and in which run a policy became the champion."""
    rows = store.query("SELECT run, number, json_extract(json, '$.kind') FROM release WHERE policy = ?", (policy,))
    return {"released": ", ".join(f"number {n} of run {run} ({kind})" for run, n, kind in rows)} if rows else {}


def unit_of(unit: str) -> str:
    """A unit as it follows its number; what has none is left without."""
    return "" if unit == "1" else f" {unit}"


def outcome(e: Episode) -> str:
    """How an attempt ended, in words."""
    o = e.outcome
    return " ".join([o.label, f"(by {o.judged_by})", *(x for x in (o.trigger, o.family, o.reason) if x)])


def some(names: Sequence[str], full: bool) -> str:
    """The first few names and a count of the rest, or all of them."""
    shown = names if full else names[:FIRST]
    return ", ".join(shown) + (f" and {len(names) - FIRST} more" if len(names) > len(shown) else "")
