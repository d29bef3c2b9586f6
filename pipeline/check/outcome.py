"""Whether the recorded outcome is what the robot perceived, and whether a person's consent is there."""

from collections.abc import Iterator

import numpy as np

from pipeline.check.signals import Rows, Signals
from pipeline.consent import NO_CONSENTS
from schemas.consent import NO_CONSENT, SIMULATED
from schemas.contract import Contract, Success
from schemas.finding import Finding

NEEDED = ("object_x", "object_y", "object_z", "target_x", "target_y", "ee_x", "ee_y", "ee_z", "gripper")
"""Columns, wherever they are recorded, that the task's success is judged by; see pipeline.frames."""
ROUNDING_M = 0.003
"""What two looks at one object differ by [m]."""
HANDED_OVER = ("corrected", "oracle")
"""Sources of episodes that a trigger ended for the policy only: a person went on, and says how they ended."""
SEEN_OUTCOMES = ("success", "failure")


def success_flag(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """The recorded outcome against the task's predicate on what the robot perceived.

    Perception is noisy, so the predicate is asked with slack in favour of the record: a success is doubted only if
    the object ends off the mark, in the air or in the hand by more than the slack; a failure only if everything that
    success asks for held with room to spare over the last ticks, and no trigger ended the attempt.
    """
    label, trigger = _recorded(signals)
    if contract.success is None or label not in SEEN_OUTCOMES:
        return
    found = perceived(signals)
    if found is None or len(found["gripper"]) < contract.success.hold_ticks:
        return
    rule, slack = contract.success, contract.thresholds.success_slack_m
    near = np.hypot(found["object_x"] - found["target_x"], found["object_y"] - found["target_y"])
    away = np.sqrt(sum((found[f"ee_{k}"] - found[f"object_{k}"]) ** 2 for k in "xyz"))
    last = slice(1 - max(rule.hold_ticks, 2), None)  # the attempt ends at the tick after its last row
    where, mend = signals.name, "label the episode again, or drop it: a wrong flag teaches failures as successes"
    rise = float(found["object_z"][-1] - found["object_z"][0])
    if label == "success" and near[-1] > rule.within_m + slack:
        yield Finding(check="success-flag", what=f"recorded as success, but the object ends {near[-1] * 1e3:.0f} mm "
                      "off its mark", where=where, frame=len(near) - 1, value=float(near[-1]),
                      limit=rule.within_m + slack, mend=mend)
    elif label == "success" and (found["gripper"][-1] < rule.open_m - slack or away[-1] < rule.away_m - slack):
        yield Finding(check="success-flag", what="recorded as success, but the hand has not let go of the object",
                      where=where, frame=len(near) - 1, value=float(away[-1]), limit=rule.away_m - slack, mend=mend)
    elif label == "success" and rise > rule.low_m + slack:
        yield Finding(check="success-flag", what=f"recorded as success, but the object ends {rise * 1e3:.0f} mm above "
                      "where it lay", where=where, frame=len(near) - 1, value=rise, limit=rule.low_m + slack, mend=mend)
    elif label == "failure" and not trigger and (near[last] < rule.within_m - _room(signals, rule, slack)).all() \
            and (found["gripper"][last] > rule.open_m).all() and (away[last] > rule.away_m).all():
        yield Finding(check="success-flag", what="recorded as failure, but the object lies on its mark, let go",
                      where=where, frame=len(near) - 1, value=float(near[-1]), limit=rule.within_m, mend=mend)


def _room(signals: Signals, rule: Success, slack: float) -> float:
    """How much closer than it must an object lie before a failure is doubted [m].

    A simulator judges by the truth, which perception misses by the slack; sensors and people judge by what is recorded.
    """
    by_people = signals.metadata.get("episode", {}).get("source") in HANDED_OVER
    told = "operator" if by_people else "simulator"
    judge = signals.episode.outcome.judged_by if signals.episode is not None else told
    return min(slack, rule.within_m / 2) if judge == "simulator" else ROUNDING_M


def _recorded(signals: Signals) -> tuple[str, str]:
    """The recorded outcome, and the trigger that ended an attempt of a policy."""
    record = signals.metadata.get("episode", {})
    if signals.episode is None:
        return record.get("outcome", ""), "" if record.get("source") in HANDED_OVER else record.get("trigger", "")
    outcome = signals.episode.outcome
    handed_over = any(s.kind == "intervention" for s in signals.episode.segments)
    return outcome.label, "" if handed_over else outcome.trigger or ""


def perceived(signals: Signals) -> dict[str, Rows] | None:
    """NEEDED name -> values over time; None unless all are there, as long as each other."""
    found: dict[str, Rows] = {}
    for reference, _, column in signals.numbers():
        if "command" in reference or reference.endswith((".velocity", ".effort")) or reference.startswith("action"):
            continue
        for place, name in enumerate(column.names):
            if name in NEEDED:
                found.setdefault(name, column.rows[:, place])
    if set(found) != set(NEEDED) or len({len(v) for v in found.values()}) != 1:
        return None
    return found


def consent(signals: Signals, contract: Contract) -> Iterator[Finding]:
    """A recording of a person, or of nobody knows whom, that names no consent record."""
    if not contract.consent:
        return
    episode, record = signals.episode, signals.metadata.get("episode", {})
    named = episode.consent if episode is not None else record.get("consent", "")
    what = None
    if named in ("", NO_CONSENT):
        what = "no consent record is named"
    elif named == SIMULATED and episode is not None and NO_CONSENTS.flaw(episode) is not None:
        what = f"a person commands the robot ({episode.origin}), yet its consent is {SIMULATED!r}"
    if what:
        yield Finding(check="consent", what=what, where=signals.name,
                      mend="have the person consent: hardcase consent add, then record with --consent; or set consent: "
                      "false in the contract of a robot that nobody can be seen or felt in")
