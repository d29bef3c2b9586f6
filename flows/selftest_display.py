"""What the self-test says, for people and for machines."""

from collections.abc import Sequence
from typing import Any

from pipeline.selftest.judging import Planted, Result
from pipeline.selftest.referees import REFEREES, Asked, Opinion


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
        **({} if asked is None else {"referee_alarms": asked.alarms}),
    }


def _fault(planted: Planted, asked: Asked | None) -> dict[str, Any]:
    fault = planted.fault
    told: dict[str, Any] = {"name": planted.name, "what": fault.what, "on": fault.on, "expected": list(fault.expect),
                            "caught_by": list(planted.caught_by), "also": list(planted.also), "said": planted.said}
    if asked is not None and planted.name in asked.planted:
        told["referees"] = {name: list(o.reasons) if not o.passed else []
                            for name, o in asked.planted[planted.name].items()}
    return told


def told(result: Result, asked: Asked | None) -> list[str]:
    """A line for each fault, one for each false alarm, then the sums."""
    head = ["fault", "caught by", *(() if asked is None else REFEREES), "what it says"]
    rows = [[p.name, ", ".join(p.caught_by) or "MISSED", *_opinions(p, asked), p.said] for p in result.planted]
    lines = _aligned([head, *rows])
    lines += [f"FALSE ALARM  {a.where.parent.name}/{a.where.name}: {a.said}" for a in result.alarms]
    lines += [f"REFEREE  {alarm}" for alarm in (asked.alarms if asked is not None else ())]
    pictures = "rendered" if result.rendered else "drawn, because nothing renders here (hardcase doctor)"
    return [*lines, "", f"{len(result.planted) - len(result.missed)} of {len(result.planted)} faults caught",
            f"{len(result.alarms)} false alarms on {result.clean_episodes} clean episodes and "
            f"{result.clean_datasets} clean datasets; pictures were {pictures}"]


def _opinions(planted: Planted, asked: Asked | None) -> list[str]:
    if asked is None:
        return []
    given = asked.planted.get(planted.name)
    return [_word(given[name]) if given else "" for name in REFEREES]


def _word(opinion: Opinion) -> str:
    return "-" if opinion.passed else ", ".join(reason.split()[0] for reason in opinion.reasons)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]) - 1)]
    return ["  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[-1]]) for row in rows]
