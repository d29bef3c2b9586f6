"""The report of trainings by reinforcement as a page: several seeds, or several ways to train, drawn together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.ppo.config import Order
from pipeline.ppo.record import TrainingRecord
from pipeline.report.learned import Learned, success_charts, term_charts, unit, update_charts
from pipeline.report.rendering import render
from pipeline.report.text import percent, words
from pipeline.statistics import Interval

LONGEST_LABEL = 60


@dataclass(frozen=True, slots=True)
class ShownTraining:
    """A training and what became of it."""

    group: str
    name: str
    record: TrainingRecord
    folder: str
    policy: str | None
    """sha256 of policy.onnx; None where it is not written yet."""
    evaluations: tuple[Mapping[str, Any], ...] = ()
    """As `hardcase rl evaluate --json` gives them, one a kind of start."""

    @property
    def learned(self) -> Learned:
        """As the charts want it."""
        return Learned(self.group, self.name, self.record.order.task, self.record.curve)


@dataclass(frozen=True, slots=True)
class Pooled:
    """One group over its seeds, from one kind of start."""

    group: str
    stratum: str
    seeds: int
    policy: Interval
    ahead: Interval
    """Of zero action, on the same starts."""


def trainings_page(shown: Sequence[ShownTraining], pooled: Sequence[Pooled], *, command: str,
                   notes: Sequence[str] = ()) -> str:
    """HTML with charts and tables of these trainings; see `render`.

    Args:
        shown: the trainings, those of a group together.
        pooled: groups of several seeds.
        command: that makes this page again.
        notes: what a reader must know, such as that a training is not over.
    """
    learned = [one.learned for one in shown]
    terms = {t: weight for one in shown for t, weight in one.record.order.task.weights.items()}
    return render(
        "trainings.html.j2", interactive=True, filters={"bounds": _bounds}, shown=shown, pooled=pooled,
        title=_title(shown, pooled), command=command, notes=notes, terms=terms, units={t: unit(t) for t in terms},
        charts={"success": success_charts(learned), "terms": term_charts(learned, baseline_terms(shown)),
                "updates": update_charts(learned)})


def baseline_terms(shown: Sequence[ShownTraining]) -> dict[str, dict[str, float]]:
    """Zero and random actions -> term -> weighted mean a tick in the first evaluation of each training, mean of all."""
    found: dict[str, dict[str, list[float]]] = {}
    for one in shown:
        for evaluation in one.evaluations[:1]:
            for name, arm in evaluation["arms"].items():
                for term, value in arm["terms"].items() if name != "policy" else ():
                    found.setdefault(name, {}).setdefault(term, []).append(value)
    return {name: {t: sum(v) / len(v) for t, v in terms.items()} for name, terms in found.items()}


def grouped(orders: Sequence[Order]) -> list[str]:
    """What to call the group of each order.

    Orders of one group differ in their seed, or in whose weights they go on from. A name says body and task, and of
    several groups what they differ in.
    """
    flat = [_flat(order) for order in orders]
    keys = list(dict.fromkeys(key for one in flat for key in one))
    differing = [key for key in keys if len({repr(one.get(key)) for one in flat}) > 1 and key not in ("body", "name")]
    names: list[str] = []
    for one in flat:
        parts = filter(None, (_part(key, one.get(key)) for key in differing))
        label = f"{one['body']} {one['name']}" + "".join(f", {part}" for part in parts)
        names.append(label if len(label) <= LONGEST_LABEL else label[:LONGEST_LABEL - 1] + "…")
    if len(set(names)) < len({repr(one) for one in flat}):  # a cut label may hide the difference
        numbers = {text: k + 1 for k, text in enumerate(dict.fromkeys(repr(one) for one in flat))}
        return [f"{name} ({numbers[repr(one)]})" for name, one in zip(names, flat, strict=True)]
    return names


def _flat(order: Order) -> dict[str, Any]:
    values = order.model_dump(mode="json")
    values.pop("seed")
    ppo = values.pop("ppo")
    starts = values.pop("curriculum", None)
    begins = "warm" if values.pop("goes_on", None) else "from scratch"
    share = None if starts is None else starts["hard_share"]
    return {"body": values.pop("body"), "name": values.pop("name"), "begins": begins, "hard starts": share,
            **values, **ppo}


def _part(key: str, value: Any) -> str:
    if value is None:
        return ""
    if key in ("begins", "stratum"):
        return str(value)
    if isinstance(value, dict | list):
        return f"other {key}"
    return f"{words(key)} {value}"


def _title(shown: Sequence[ShownTraining], pooled: Sequence[Pooled]) -> str:
    first = shown[0]
    what = f"{first.record.order.body} {first.record.order.name}"
    if pooled:
        return f"{what}: {percent(pooled[0].policy.estimate)} full attempts"
    if first.evaluations:
        return f"{what}: {percent(first.evaluations[0]['arms']['policy']['rate'])} full attempts"
    return f"{what}: {len(shown)} training{'s' * (len(shown) > 1)}"


def _bounds(found: Interval | Mapping[str, float]) -> str:
    low, high = (found.low, found.high) if isinstance(found, Interval) else (found["low"], found["high"])
    return f"[{100 * low:.1f}, {100 * high:.1f}]".replace("-", "−")
