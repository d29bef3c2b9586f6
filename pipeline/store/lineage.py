"""Why a thing is as it is: from any id back to recordings, draws, seeds, code and config, and forward to its users."""

import re
from collections.abc import Callable, Sequence
from types import MappingProxyType

from pipeline.files import sha256
from pipeline.store.facts import (
    checked,
    foreign_of,
    lost,
    made,
    outcome,
    releases,
    some,
    unit_of,
    users,
    worth_of,
)
from pipeline.store.graph import graph_of, in_order
from pipeline.store.groups import Record, group_facts, records
from pipeline.store.ingests import INGEST
from pipeline.store.origins import tell_check, tell_consent, tell_conversion, tell_erased, tell_worth
from pipeline.store.reader import Reader
from pipeline.store.records import RunInfo
from pipeline.store.tree import Lineage, Used, render, to_json
from schemas.edits import line
from schemas.episode import Episode

__all__ = ["render", "to_json", "why"]

def why(store: Reader, id: str, *, full: bool = False, back: bool = True, forward: bool = True) -> Lineage:
    """The tree of causes of a thing, and what used it.

    Args:
        store: an open store.
        id: an id, or 8 and more of its first digits; see `locate`.
        full: every episode on its own with whole hashes, and whole recipes, instead of groups with counts.
        back: tell the causes; else only the thing and its users.
        forward: tell the users.

    Raises:
        StoreError: nothing or several things have such an id.
    """
    table, whole = locate(store, id)
    told = TELL[table](store, whole, full)
    if not back:
        told = told.model_copy(update={"children": ()})
    return told.model_copy(update={"used_by": used_by(store, table, whole)}) if forward else told


def used_by(store: Reader, kind: str, id: str) -> tuple[Used, ...]:
    """Everything that came of a thing, in groups, causes before effects."""
    graph = graph_of(store, kind, id, back=False)
    return tuple(Used(kind=n.kind, title=n.title, notes=n.lines, ids=n.ids) for n in in_order(graph) if not n.focus)


def locate(store: Reader, id: str) -> tuple[str, str]:
    """Kind and whole id of what a person names: an id or its beginning, a consent, or the hash of a log or recording.

    Raises:
        StoreError: nothing or several things have such an id.
    """
    if id in store.consents():
        return "consent", id
    if re.fullmatch("[0-9a-f]{64}", id):
        for table, column in (("raw_log", "id"), ("erased", "id"), ("episode", "blob")):
            if rows := store.query(f"SELECT id FROM {table} WHERE {column} = ? LIMIT 1", (id,)):
                return table, str(rows[0][0])
    return store.find(id[:16] if len(id) == 64 else id)


def _policy(store: Reader, id: str, full: bool) -> Lineage:
    p = store.policy(id)
    facts = {
        "kind": p.kind, "generation": str(p.generation), "seed": str(p.seed), "steps": str(p.steps),
        "config": p.config, "training code": p.code, "checkpoint": p.checkpoint,
        "files": some([f"{name} {sha if full else sha[:12]}" for name, sha in sorted(p.files.items())], full),
        **_went_on(store, id), **made(store, "policy", id), **lost(store, p.dataset, "saw what was forgotten"),
    }  # fmt: skip
    verdicts = [_verdict_line(store, v.id) for v in store.verdicts(candidate=id)]
    return Lineage(
        kind="policy",
        id=id,
        facts=facts | releases(store, id),
        children=(*_runs(store, "policy", id, full), *verdicts, _version(store, p.dataset, full, "trained on")),
    )


def _went_on(store: Reader, id: str) -> dict[str, str]:
    """The policy whose weights a training began with, if it did not begin at random ones."""
    rows = store.query("SELECT json_extract(step.json, '$.outputs.goes_on') FROM member JOIN step USING (run)"
                       " WHERE member.kind = 'policy' AND member.id = ? AND step.stage = 'train'"
                       " AND json_extract(step.json, '$.outputs.ids[0]') = member.id", (id,))
    return {"went on from": f"policy {rows[0][0]}"} if rows and rows[0][0] else {}


def _version(store: Reader, id: str, full: bool, role: str = "") -> Lineage:
    v = store.version(id)
    episodes = records(store, v.episodes)
    by_origin: dict[str, list[Record]] = {}
    for e in episodes:
        by_origin.setdefault(e["origin"], []).append(e)
    facts = {
        "recipe": v.recipe, "generation": str(v.generation), "digest": v.digest, "code": v.code,
        "episodes": f"{len(episodes)} ({v.frames} frames), {len(v.held_out)} held out",
        "weights": ", ".join(f"{name} {share:g}" for name, share in v.weights.items()),
        "inputs": some([b if full else b[:12] for b in v.inputs], full),
        "folder": v.path, **made(store, "version", id), **({"parent": v.parent} if v.parent else {}),
        **({"edits": "; ".join(map(line, v.edits))} if v.edits else {}),
        **checked(store, v.digest), **worth_of(store, v.episodes), **lost(store, id, "incomplete"),
    }  # fmt: skip
    if v.starts:
        facts["hard cases"] = f"{len(v.starts)}: {some(v.starts, full)}"
    groups = [_group(store, origin, members, full) for origin, members in by_origin.items()]
    return Lineage(kind="version", id=id, role=role, facts=facts, children=tuple(groups))


def _group(store: Reader, origin: str, episodes: Sequence[Record], full: bool) -> Lineage:
    facts = group_facts(store, episodes, full)
    if full:
        return Lineage(kind="group", id=origin, facts=facts,
                       children=tuple(_episode_line(Episode.model_validate(e)) for e in episodes))
    return Lineage(kind="group", id=origin, facts=facts | {"ids": some([e["id"] for e in episodes], full)})


def _episode_line(e: Episode, role: str = "") -> Lineage:
    s = e.scene
    facts = {
        "origin": e.origin, "generation": str(e.generation), "outcome": outcome(e),
        "scene": f"{s.family} seed {s.seed}, {s.robot}, {s.scene}, {s.task}, {s.stratum}",
        "recording": e.blob or ("none; made again from its parent and seed" if e.parent else "none"),
    }  # fmt: skip
    if s.twin is not None:
        facts["twin"] = str(s.twin)
    if s.draws:
        facts["draws"] = ", ".join(f"{d.name} {d.value:.6g}{unit_of(d.unit)}" for d in s.draws)
    origin = {"transform": e.transform, "parent": e.parent, "policy": e.policy}
    facts |= {name: value for name, value in origin.items() if value}
    return Lineage(kind="episode", id=e.id, role=role, facts=facts)


def _episode(store: Reader, id: str, full: bool, role: str = "", forward: bool = True) -> Lineage:
    e = store.episode(id)
    node = _episode_line(e, role)
    cases = store.hard_cases(episode=id) if role != "attempt" else []  # an attempt is told below its hard case
    children = [_hard_case_line(store, c.id) for c in cases]
    if e.parent:
        children.append(_episode(store, e.parent, full, "parent", forward=False))
    came = [(e.transform or "").removeprefix(INGEST)] if e.origin == "ingested" else []
    facts = node.facts | foreign_of(store, came, full) | made(store, "episode", id) | checked(store, e.blob)
    facts |= worth_of(store, [id])
    if forward:
        children += _runs(store, "episode", id, full)
        facts |= users(store, id, full)
    return node.model_copy(update={"facts": facts, "children": tuple(children)})


def _verdict_line(store: Reader, id: str, role: str = "judged by") -> Lineage:
    v = store.verdict(id)
    facts = {
        "decision": f"{v.decision}: {v.reason}", "candidate": v.candidate, "champion": v.champion or "none",
        "scenes": str(v.scenes), "p": "none" if v.p is None else f"{v.p:.4g}", "margin": f"{v.margin:g}",
    }  # fmt: skip
    return Lineage(kind="verdict", id=id, role=role, facts=facts | made(store, "verdict", id))


def _verdict(store: Reader, id: str, full: bool) -> Lineage:
    node = _verdict_line(store, id, "")
    candidate = _policy(store, store.verdict(id).candidate, full).model_copy(update={"role": "candidate"})
    return node.model_copy(update={"children": (candidate,)})


def _hard_case_line(store: Reader, id: str, role: str = "hard case") -> Lineage:
    c = store.hard_case(id)
    facts = {
        "trigger": f"{c.trigger} at tick {c.tick}", "family": c.family, "stratum": c.stratum,
        "correction": f"{c.correction} ({'succeeded' if c.corrected else 'failed'})" if c.correction else "none",
    }  # fmt: skip
    if c.judgement is not None:
        sides = (("champion", c.judgement.champion), ("candidate", c.judgement.candidate))
        facts |= {"wrong": f"{c.wrong}"} | {name: f"{s.policy}, {s.success.successes} of {s.success.n} draws succeeded"
                                            for name, s in sides}
    return Lineage(kind="hard_case", id=id, role=role, facts=facts | made(store, "hard_case", id))


def _hard_case(store: Reader, id: str, full: bool) -> Lineage:
    c, node = store.hard_case(id), _hard_case_line(store, id, "")
    children = [_episode(store, c.episode, full, "attempt")]
    if c.correction:
        children.append(_episode(store, c.correction, full, "correction"))
    if c.judgement is not None:
        children.append(_policy(store, c.judgement.candidate.policy, full).model_copy(update={"role": "candidate"}))
    return node.model_copy(update={"children": tuple(children)})


def _run(store: Reader, id: str, full: bool, role: str = "") -> Lineage:
    history = store.history(id)
    info = history[0]
    whole = RunInfo.model_dump_json(info, include={"recipe"})
    facts = {
        "recipe": f"{info.recipe_name}, {whole if full else 'sha256 ' + sha256(whole.encode())[:12]}",
        "seed": str(info.seed), "twin": str(info.twin), "control": info.control or "none",
    }  # fmt: skip
    for number, call in enumerate(history, 1):
        versions = ", ".join(f"{name} {version}" for name, version in sorted(call.versions.items()))
        facts[f"call {number}"] = (
            f"{call.command} | commit {call.commit or 'unknown'} | {versions or 'versions unknown'}"
        )
    return Lineage(kind="run", id=id, role=role, facts=facts)


def _raw_log(store: Reader, id: str, full: bool) -> Lineage:
    """Forward: what was made of a foreign log, and who used that."""
    log = store.raw_log(id)
    assert log is not None, "it was found by its id"
    children: list[Lineage] = []
    for c in store.conversions(id):
        episodes = [str(e) for (e,) in store.query(
            "SELECT episode.id FROM ingestion JOIN episode"
            " ON json_extract(episode.json, '$.transform') = 'ingest ' || ingestion.id"
            " WHERE ingestion.conversion = ? ORDER BY episode.place", (c.id,))]
        facts = {"state": f"{c.state}{': ' + c.reason if c.reason else ''}", "code": c.code,
                 "episodes": f"{len(episodes)}: {some(episodes, full)}" if episodes else "none"}
        children.append(Lineage(kind="conversion", id=c.id, role="made of it",
                                facts=facts | (users(store, episodes[0], full) if episodes else {})))
    facts = {"size": f"{log.size_bytes} B", "first ingested from": log.source, **checked(store, id)}
    return Lineage(kind="raw_log", id=id, facts=facts, children=tuple(children))


TELL: MappingProxyType[str, Callable[[Reader, str, bool], Lineage]] = MappingProxyType(
    {
        "policy": _policy,
        "version": _version,
        "verdict": _verdict,
        "hard_case": _hard_case,
        "episode": _episode,
        "run": _run,
        "raw_log": _raw_log,
        "consent": tell_consent,
        "conversion": tell_conversion,
        "checked": tell_check,
        "worth": tell_worth,
        "erased": tell_erased,
    }
)
"""Table -> how its rows are explained."""


def _runs(store: Reader, kind: str, id: str, full: bool) -> list[Lineage]:
    rows = store.query("SELECT run FROM member WHERE kind = ? AND id = ? ORDER BY run", (kind, id))
    return [_run(store, str(run), full, "made in") for (run,) in rows]
