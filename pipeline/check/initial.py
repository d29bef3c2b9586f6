"""A first contract, written from good logs."""

from collections.abc import Mapping, Sequence

import numpy as np
import yaml

from pipeline.check.contract import completed, number
from pipeline.check.following import numbers
from pipeline.check.motion import unit_of
from pipeline.check.signals import Column, Rows, Signals, Subject
from pipeline.check.swapped import fingerprint
from pipeline.recording.dialect import FRAME_TOPICS
from schemas.contract import CameraRule, Contract, Evaluation, Limit, Thresholds, TopicRule

SPEED_ROOM = 2
"""How much faster than the fastest of a good log a joint may move: another start asks for another turn of the wrist."""


def from_log(subject: Subject, *, name: str = "default") -> Contract:
    """A contract that a good log keeps, with room for what the next good log does otherwise.

    Rates are those seen; gaps and jitter twice what was seen, and no less than without a contract; limits what was
    seen and a tenth of its range, speeds twice that of the fastest joint; cameras get their fingerprint. Offsets
    between clocks are not taken over.
    """
    own = completed(Contract(name=name), subject)
    topics: dict[str, TopicRule] = {}
    cameras: dict[str, CameraRule] = {}
    limits = dict(own.limits)
    for signals in subject.recordings:
        for topic in signals.topics.values():
            topics.setdefault(topic.name, _rule(signals, topic.name))
        for camera in signals.cameras.values():
            if len(camera.thumbs):
                cameras.setdefault(camera.name, CameraRule(width=camera.size[0] or None, height=camera.size[1] or None,
                                                           fingerprint=fingerprint(camera)))
    for pair in own.motion:
        for reference in (pair.measured, pair.commanded) if pair.kind == "target" else ():
            seen = [(f[0].seconds, f[2]) for s in subject.recordings if (f := s.find(reference)) is not None]
            if seen:
                limits[reference] = _seen(reference, seen, own.limits.get(reference, {}))
    evaluation = own.evaluation or _same_as(subject)
    return own.model_copy(update={"topics": topics, "cameras": cameras, "limits": limits, "evaluation": evaluation})


def _rule(signals: Signals, name: str) -> TopicRule:
    topic = signals.topics[name]
    if not topic.steady or topic.tabled:
        return TopicRule(type=topic.type or None, required=topic.tabled or name in FRAME_TOPICS)
    steps, usual = np.diff(topic.log_ns) / 1e9, Thresholds()
    share = usual.camera_jitter_periods if name in signals.cameras else usual.jitter_periods
    off = float(np.quantile(np.abs(steps - topic.period_s), 0.95))
    span = (int(topic.log_ns[-1]) - int(topic.log_ns[0])) / 1e9
    return TopicRule(type=topic.type or None, rate_hz=_tidy((len(topic) - 1) / span),
                     max_gap_s=_tidy(max(2 * float(steps.max()), usual.gap_periods * topic.period_s)),
                     jitter_s=_tidy(max(2 * off, share * topic.period_s)),
                     required=not name.startswith(("/policy/", "/reward/", "/signal/")))


def _seen(reference: str, seen: Sequence[tuple[Rows, Column]], known: Mapping[str, Limit]) -> dict[str, Limit]:
    """Limits of each column; each may move as fast as the fastest of its unit: a joint that had nothing to do here may
    have more to do elsewhere."""
    names = seen[0][1].names
    alike = [(times, numbers(column.rows)) for times, column in seen if column.names == names]
    low = np.min([rows.min(axis=0) for _, rows in alike], axis=0)
    high = np.max([rows.max(axis=0) for _, rows in alike], axis=0)
    speed = np.max([_speeds(times, rows) for times, rows in alike], axis=0)
    room = np.maximum(0.1 * (high - low), np.maximum(0.01 * np.maximum(np.abs(low), np.abs(high)), 1e-3))
    given = [known.get(name, Limit()) for name in names]
    units = [g.unit or unit_of(name, Contract(), reference) for g, name in zip(given, names, strict=True)]
    found: dict[str, Limit] = {}
    for k, (name, limit) in enumerate(zip(names, given, strict=True)):
        fastest = SPEED_ROOM * max(float(v) for v, unit in zip(speed, units, strict=True) if unit == units[k])
        found[name] = Limit(low=_tidy(float(low[k] - room[k])) if limit.low is None else limit.low,
                            high=_tidy(float(high[k] + room[k])) if limit.high is None else limit.high,
                            speed=limit.speed or (_tidy(fastest) if fastest > 0 else None), unit=units[k])
    return found


def _speeds(times_s: Rows, rows: Rows) -> Rows:
    """The largest rate of change of each column [unit/s], shape (d,); a late message makes no joint fast."""
    steps = np.diff(times_s)
    if not steps.size or not np.median(steps) > 0:
        return np.zeros(rows.shape[1])
    return (np.abs(np.diff(rows, axis=0)) / np.maximum(steps, np.median(steps))[:, None]).max(axis=0)


def _same_as(subject: Subject) -> Evaluation | None:
    """Robot, task and rate as the log names them."""
    record = next((s.metadata.get("episode", {}) for s in subject.recordings), dict[str, str]())
    hz = number(record.get("control_hz"))
    if not record.get("robot"):
        return None
    return Evaluation(robot=record["robot"], task=record.get("task"), control_hz=hz)


def _tidy(value: float) -> float:
    """Four digits: nobody needs more of a limit."""
    return float(f"{value:.4g}")


def to_yaml(contract: Contract) -> str:
    """The contract as a person edits it: what is at its default is left out."""
    content = contract.model_dump(mode="json", exclude_defaults=True)
    return yaml.safe_dump({"name": contract.name, **content}, sort_keys=False, allow_unicode=True, width=120)
