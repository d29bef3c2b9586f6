"""Charts of trainings by reinforcement: success, every reward term on its own, and what PPO says of its updates."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any

from markupsafe import Markup

from pipeline.locomotion.rewards import REWARDS
from pipeline.locomotion.tasks import LeggedTask
from pipeline.ppo.curves import Point
from pipeline.report.charts import Axis, Line, around, line_chart, shares
from pipeline.report.text import number, words

STRETCHES = 60
"""A curve is drawn as means over so many stretches of the longest one: single iterations are too noisy to compare."""
SEED, MEAN = 0.4, 1.0
"""Strength of the line of one training, and of the mean of those that differ by their seed only."""
BASELINE_COLOURS = (7, 5)
GROUP_COLOURS = (0, 1, 2, 3, 4, 6)
UPDATES: Mapping[str, tuple[str, str, str]] = MappingProxyType({
    "entropy": ("Entropy [nat]", "nat", "of the actions that are drawn; falls as the policy makes up its mind"),
    "kl": ("KL divergence [nat]", "nat", "from the policy before the update, mean over its last pass"),
    "clipped": ("Share clipped", "share", "of samples whose probability changed by more than PPO lets count"),
    "explained": ("Explained variance", "share", "of the returns that the critic foretold; 1 is all, 0 is none"),
    "value_loss": ("Critic's loss", "squared scaled return", "mean squared error"),
})
"""Figure of an update -> title, unit, meaning; see pipeline.ppo.curves."""


@dataclass(frozen=True, slots=True)
class Learned:
    """One training as the charts show it."""

    group: str
    """Trainings of one group share a colour and have a mean: those that differ by their seed only."""
    name: str
    """'seed 100'."""
    task: LeggedTask
    curve: Sequence[Point]
    """As training.json has it."""


type Value = Callable[[Sequence[Point]], float | None]
"""Points of a stretch -> what is drawn of them; None where they do not tell."""


def success_charts(learned: Sequence[Learned]) -> list[Markup]:
    """Share of full attempts, their length, and the reward a tick."""
    hz = learned[0].task.control_hz
    return [
        _chart("Full attempts", learned, full_share, shares("of those that ended"),
               note="share that had not fallen when their time was up, while actions are drawn"),
        _chart("Length of attempts [s]", learned, lambda points: _per(_mean_length(points), hz), None, unit="s",
               note="mean of those that ended"),
        _chart("Reward a tick", learned, lambda points: _mean(p["reward"] for p in points), None, unit="a tick",
               note="sum of the terms below"),
    ]


def term_charts(learned: Sequence[Learned],
                baselines: Mapping[str, Mapping[str, float]] = MappingProxyType({})) -> list[Markup]:
    """One small multiple a reward term: its meaning, unit and weight, all trainings, and what baselines reach.

    Args:
        learned: the trainings.
        baselines: who acts -> term -> its weighted mean a tick, as `hardcase rl evaluate` gives it.
    """
    made: list[Markup] = []
    for term in dict.fromkeys(t for one in learned for t in one.task.weights):
        having = [one for one in learned if term in one.task.weights]
        levels = {name: terms[term] for name, terms in baselines.items() if term in terms}
        made.append(_chart(words(term).capitalize(), having, _term(term), None, unit="weighted, a tick",
                           levels=levels, note=f"{meaning(term)} Unit {unit(term)}, weight {_weights(term, having)}."))
    return made


def update_charts(learned: Sequence[Learned]) -> list[Markup]:
    """PPO's own figures of its updates where they were recorded, and the spread of the actions."""
    made: list[Markup] = []
    for name, (title, its_unit, note) in UPDATES.items():
        having = [one for one in learned if any(name in p.get("update", {}) for p in one.curve)]
        if having:
            made.append(_chart(title, having, _update(name), None, unit=its_unit, note=note))
    return [*made, _chart("Spread of the actions", learned, lambda points: _mean(p["std"] for p in points), None,
                          unit="share of an action", note="standard deviation that actions are drawn with, mean")]


def full_share(points: Sequence[Point]) -> float | None:
    """Share of the attempts that ended within these iterations that were full."""
    ended = sum(p["full"] + p["fallen"] for p in points)
    return sum(p["full"] for p in points) / ended if ended else None


def meaning(term: str) -> str:
    """What a reward term measures: the first paragraph of its docstring."""
    said = (REWARDS[term].__doc__ or term).strip().split("\n\n")[0]
    return " ".join(said.split())


def unit(term: str) -> str:
    """Unit of a reward term: what stands in brackets at the end of its first sentence; 1, a pure number, otherwise."""
    said = meaning(term).rstrip(".")
    return said[said.rindex("[") + 1:-1] if said.endswith("]") and "[" in said else "1"


def _weights(term: str, learned: Sequence[Learned]) -> str:
    groups: dict[float, list[str]] = {}
    for one in learned:
        named = groups.setdefault(one.task.weights[term], [])
        if one.group not in named:
            named.append(one.group)
    if len(groups) == 1:
        return number(next(iter(groups)))
    return ", ".join(f"{number(weight)} ({', '.join(names)})" for weight, names in groups.items())


def _term(term: str) -> Value:
    return lambda points: _mean(p["terms"][term] for p in points)


def _update(name: str) -> Value:
    return lambda points: _mean(p.get("update", {}).get(name) for p in points)


def _mean(values: Any) -> float | None:
    found = [v for v in values if v is not None and isfinite(v)]
    return sum(found) / len(found) if found else None


def _per(value: float | None, hz: float) -> float | None:
    return None if value is None else value / hz


def _mean_length(points: Sequence[Point]) -> float | None:
    known = [(p["length"], p["full"] + p["fallen"]) for p in points if p["length"] is not None]
    ended = sum(n for _, n in known)
    return sum(length * n for length, n in known) / ended if ended else None


def _chart(title: str, learned: Sequence[Learned], value: Value, y: Axis | None, *, unit: str = "", note: str = "",
           levels: Mapping[str, float] = MappingProxyType({})) -> Markup:
    stretch = max(one.curve[-1]["step"] for one in learned) / STRETCHES
    groups: dict[str, list[Learned]] = {}
    for one in learned:
        groups.setdefault(one.group, []).append(one)
    lines: list[Line] = []
    for k, (group, members) in enumerate(groups.items()):
        colour = GROUP_COLOURS[k % len(GROUP_COLOURS)]
        found = {one.name: _stretches(one.curve, stretch, value) for one in members}
        if len(found) > 1:
            lines.append(_line(f"{group}, mean of {len(found)}", _means([*found.values()]), stretch, colour, MEAN))
        lines += [_line(f"{group}, {name}", one, stretch, colour, SEED if len(found) > 1 else MEAN,
                        listed=len(found) == 1) for name, one in found.items()]
    x = around("environment steps", (at for line in lines for at in line.x), zero=True)
    lines += [Line(name, (x.low, x.high), (level, level), BASELINE_COLOURS[k % 2], dashed=True)
              for k, (name, level) in enumerate(levels.items())]
    return line_chart(title, lines, x, y or around(unit, (v for line in lines for v in line.y)), note=note)


def _stretches(curve: Sequence[Point], stretch: float, value: Value) -> dict[int, float]:
    """Stretch -> value of the points within it."""
    parts: dict[int, list[Point]] = {}
    for point in curve:
        parts.setdefault(int((point["step"] - 1) / stretch), []).append(point)
    found = {k: value(points) for k, points in parts.items()}
    return {k: v for k, v in found.items() if v is not None}


def _means(several: Sequence[Mapping[int, float]]) -> dict[int, float]:
    """Mean of all trainings, in stretches that each of them has."""
    common = [k for k in several[0] if all(k in one for one in several)]
    return {k: sum(one[k] for one in several) / len(several) for k in common}


def _line(name: str, found: Mapping[int, float], stretch: float, colour: int, strength: float, *,
          listed: bool = True) -> Line:
    return Line(name, [stretch * (k + 0.5) for k in found], [*found.values()], colour, strength=strength, listed=listed)
