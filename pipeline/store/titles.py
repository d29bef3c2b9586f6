"""The few words by which a thing or a group of things is told."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from json import dumps
from types import MappingProxyType
from typing import Any

import orjson

from pipeline.store.reader import Reader

type Told = tuple[str, tuple[str, ...]]
"""A title and a few lines."""

ORIGINS: MappingProxyType[str, tuple[str, str]] = MappingProxyType({
    "scripted": ("demonstration", "demonstrations"), "teleop": ("drive by a person", "drives by people"),
    "replayed": ("variant, replayed", "variants, replayed"),
    "retargeted": ("variant, carried over", "variants, carried over"),
    "deployed": ("attempt at work", "attempts at work"), "corrected": ("correction", "corrections"),
    "oracle": ("correction by the oracle", "corrections by the oracle"),
    "ingested": ("ingested episode", "ingested episodes"), "imported": ("imported episode", "imported episodes"),
})
"""Origin -> what one episode and many are called."""

PLURAL: MappingProxyType[str, str] = MappingProxyType({"policy": "policies", "raw_log": "raw logs",
                                                       "checked": "check verdicts",
                                                       "worth": "verdicts on batches"})
SAMPLE = 20_000
"""Largest group whose seeds and families are read."""


def describe(store: Reader, kind: str, ids: Sequence[str]) -> Told:
    """Title and lines of a group."""
    if kind == "episode":
        return _episodes(store, ids)
    if kind == "erased":
        return _erased(store, ids)
    if kind == "release":
        return _releases(store, ids)
    rows = _json(store, kind, ids)
    if len(ids) > 1:
        name = PLURAL.get(kind, f"{kind.replace('_', ' ')}s")
        return f"{len(ids)} {name}", _counted(kind, rows)
    return f"{_SINGLE.get(kind, kind.replace('_', ' '))} {ids[0][:16]}", _LINES[kind](store, rows[0] if rows else {})


def _json(store: Reader, table: str, ids: Sequence[str]) -> list[dict[str, Any]]:
    rows = store.query(f"SELECT json FROM {table} WHERE id IN (SELECT value FROM json_each(?))",
                       (dumps(list(ids[:SAMPLE])),))
    return [orjson.loads(str(text)) for (text,) in rows]


_SINGLE: MappingProxyType[str, str] = MappingProxyType({"checked": "check verdict", "raw_log": "raw log",
                                                        "worth": "verdict on a batch"})


def _episodes(store: Reader, ids: Sequence[str]) -> Told:
    rows = _json(store, "episode", ids)
    first = rows[0]
    one, many = ORIGINS.get(first["origin"], (first["origin"], first["origin"]))
    generation = f"generation {first['generation']}"
    if len(ids) == 1:
        scene, draws = first["scene"], len(first["scene"]["draws"])
        return one, (
            f"{ids[0]} · {generation}", f"{first['outcome']['label']} · {first['frames']} frames",
            f"{scene['family']} seed {scene['seed']}" + (f" · {draws} draws" * bool(draws)),
            f"recording {first['blob'][:12]}" if first["blob"] else "made again from its parent and draws")
    good = sum(r["outcome"]["label"] == "success" for r in rows)
    files = len({r["blob"] for r in rows if r["blob"]})
    kept = f"{files} file{'s' * (files != 1)}"
    families = ", ".join(sorted({r["scene"]["family"] for r in rows}))
    of = f"the first {len(rows)}" if len(ids) > len(rows) else f"{len(ids)}"
    return f"{len(ids)} {many}", (generation, f"{good} of {of} succeeded", f"{families} seeds · {kept}")


def _erased(store: Reader, ids: Sequence[str]) -> Told:
    gone = store.erased(ids)
    days = sorted({str(e.at.date()) for e in gone.values()})
    reasons = list(dict.fromkeys(e.reason for e in gone.values()))
    title = f"episode {ids[0]}" if len(ids) == 1 else f"{len(ids)} episodes"
    return title, (f"forgotten on {', '.join(days)}", *reasons[:2])


def _releases(store: Reader, ids: Sequence[str]) -> Told:
    if len(ids) > 1:
        return f"{len(ids)} releases", ()
    run, number = ids[0].split(" ")
    release = store.releases(run)[int(number) - 1]
    now = store.champion(run) == release
    return f"release {number}", (f"{release.kind} of run {run}", *(["the champion now"] if now else []))


def _counted(kind: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    key = {"hard_case": "family", "verdict": "decision", "conversion": "state", "policy": "kind"}.get(kind)
    told = Counter(str(r[key]) for r in rows).most_common(3) if key else []
    lines = [", ".join(f"{n} {name}" for name, n in told)] if told else []
    if kind == "hard_case":
        lines.append(f"{sum(r['corrected'] for r in rows)} of {len(rows)} corrected")
    if "generation" in (rows[0] if rows else {}):
        low, high = min(r["generation"] for r in rows), max(r["generation"] for r in rows)
        lines.append(f"generation {low}" if low == high else f"generations {low} to {high}")
    return tuple(lines)


def _version(store: Reader, v: Mapping[str, Any]) -> tuple[str, ...]:
    lost = len(v.get("erased", ()))
    return (*([f"incomplete: erased {lost} episodes"] if lost else []),
            f"generation {v['generation']} · recipe {v['recipe']}",
            f"{len(v['episodes']):,} episodes · {v['frames']:,} frames", f"code {v['code'][:12]}")


def _policy(store: Reader, p: Mapping[str, Any]) -> tuple[str, ...]:
    lost = len(store.erased_in(p["dataset"]))
    return (*([f"saw what was forgotten: {lost} episodes"] if lost else []),
            f"generation {p['generation']} · seed {p['seed']} · {p['steps']} steps",
            f"config {p['config'][:12]}", f"code {p['code'][:12]}")


def _verdict(store: Reader, v: Mapping[str, Any]) -> tuple[str, ...]:
    return v["decision"], f"{v['scenes']} scenes" + (f" · p {v['p']:.2g}" if v["p"] is not None else "")


def _hard_case(store: Reader, c: Mapping[str, Any]) -> tuple[str, ...]:
    return f"{c['family']} · {c['stratum']}", f"{c['trigger']} at tick {c['tick']}", \
        "corrected" if c["corrected"] else "not corrected"


def _run(store: Reader, r: Mapping[str, Any]) -> tuple[str, ...]:
    return f"recipe {r['recipe_name']}", f"seed {r['seed']} · twin {r['twin']}", f"commit {r['commit'] or 'unknown'}"


def _consent(store: Reader, c: Mapping[str, Any]) -> tuple[str, ...]:
    revoked = store.consent(str(c["id"])).revoked
    return (*([f"revoked on {revoked.date()}"] if revoked else []), f"{c['operator']} at {c['site']}",
            f"{', '.join(c['purposes'])} until {c['expires']}")


def _raw_log(store: Reader, log: Mapping[str, Any]) -> tuple[str, ...]:
    return f"{log['size_bytes']:,} B", str(log["source"])[-34:]


def _conversion(store: Reader, c: Mapping[str, Any]) -> tuple[str, ...]:
    return c["state"], f"code {c['code'][:12]}"


def _checked(store: Reader, c: Mapping[str, Any]) -> tuple[str, ...]:
    return "passed" if c["passed"] else "FAILED", f"{len(c['checks'])} checks of {c['name'][:20]}", \
        f"contract {c['contract'][:12]}"


def _worth(store: Reader, w: Mapping[str, Any]) -> tuple[str, ...]:
    return w["decision"], f"{w['says'][:30]}", f"{len(w['seeds_with'])} + {len(w['seeds_without'])} seeds"


_LINES: MappingProxyType[str, Callable[[Reader, Mapping[str, Any]], tuple[str, ...]]] = MappingProxyType({
    "version": _version, "policy": _policy, "verdict": _verdict, "hard_case": _hard_case, "run": _run,
    "consent": _consent, "raw_log": _raw_log, "conversion": _conversion, "checked": _checked, "worth": _worth,
})
"""Kind -> what is said of a single thing."""
