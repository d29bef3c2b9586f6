"""What the self-test says, for people and for machines."""

from collections.abc import Iterable, Sequence
from typing import Any

from pipeline.selftest.dataset_referees import DATASET_REFEREES
from pipeline.selftest.judging import Planted, Result
from pipeline.selftest.opinions import Asked
from pipeline.selftest.referees import REFEREES


def as_json(result: Result, asked: Asked | None) -> dict[str, Any]:
    """The result for machines."""
    return {
        "passed": result.passed,
        "faults": [_fault(p, asked) for p in result.planted],
        "clean_episodes": result.clean_episodes,
        "clean_datasets": result.clean_datasets,
        "rendered": result.rendered,
        "false_alarms": len(result.alarms),
        "alarms": [{"name": a.where.name, "said": a.said} for a in result.alarms],
        **({} if asked is None else {"referee_alarms": list(asked.alarms)}),
    }


def _fault(planted: Planted, asked: Asked | None) -> dict[str, Any]:
    fault = planted.fault
    told: dict[str, Any] = {"name": planted.name, "what": fault.what, "on": fault.on, "expected": list(fault.expect),
                            "caught_by": list(planted.caught_by), "also": list(planted.also), "said": planted.said}
    if asked is not None and planted.name in asked.planted:
        told["referees"] = {name: {"passed": o.passed, "reasons": list(o.reasons), "remarks": list(o.remarks)}
                            for name, o in asked.planted[planted.name].items()}
    return told


def told(result: Result, asked: Asked | None) -> list[str]:
    """A line for each fault, one for each false alarm, then the sums."""
    lines: list[str] = []
    tables = (None,) if asked is None else (REFEREES, DATASET_REFEREES)
    for referees in tables:
        head = ["fault", "caught by", *(referees or ()), "what it says"]
        rows = [[p.name, ", ".join(p.caught_by) or "MISSED", *_words(p, asked, referees or ()), p.said]
                for p in result.planted if asked is None or ("dataset" in p.fault.on) == (referees is DATASET_REFEREES)]
        lines += [*([""] if lines else []), *_aligned([head, *rows])]
    lines += [f"FALSE ALARM  {a.where.parent.name}/{a.where.name}: {a.said}" for a in result.alarms]
    lines += [f"REFEREE  {alarm}" for alarm in (asked.alarms if asked is not None else ())]
    pictures = "rendered" if result.rendered else "drawn, because nothing renders here (hardcase doctor)"
    return [*lines, "", f"{len(result.planted) - len(result.missed)} of {len(result.planted)} faults caught",
            f"{len(result.alarms)} false alarms on {result.clean_episodes} clean episodes and "
            f"{result.clean_datasets} clean datasets; pictures were {pictures}"]


def _words(planted: Planted, asked: Asked | None, referees: Iterable[str]) -> list[str]:
    return [asked.planted[planted.name][name].word for name in referees] if asked is not None else []


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]) - 1)]
    return ["  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[-1]]) for row in rows]
