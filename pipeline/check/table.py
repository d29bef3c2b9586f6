"""CHECKS: every check by name, what it says and what it needs to look at."""

from collections.abc import Callable, Iterable
from types import MappingProxyType
from typing import NamedTuple

from pipeline.check import cameras, fit, identity, messages, motion, outcome, swapped, timing, values, video
from pipeline.check.signals import Signals, Subject
from schemas.contract import Contract
from schemas.finding import Finding

type Check = Callable[[Subject, Contract], Iterable[Finding]]
type OfOne = Callable[[Signals, Contract], Iterable[Finding]]
type Lacks = Callable[[Subject, Contract], str]
"""What a subject lacks for a check, in words; empty where the check has something to look at."""


class Entry(NamedTuple):
    """One check of the table."""

    run: Check
    lacks: Lacks
    meaning: str


def _each(check: OfOne) -> Check:
    """A check of one recording as a check of all recordings of a subject; findings in a dataset name their episode."""
    def run(subject: Subject, contract: Contract) -> Iterable[Finding]:
        for signals in subject.recordings:
            for finding in check(signals, contract):
                own = subject.tables is not None and signals.name not in finding.where
                yield finding.model_copy(update={"where": f"{signals.name} {finding.where}"}) if own else finding
    return run


def _nothing(subject: Subject, contract: Contract) -> str:
    return "" if any(s.topics for s in subject.recordings) else "it holds no message"


def _clocks(subject: Subject, contract: Contract) -> str:
    return _nothing(subject, contract) if subject.tables is None else "a dataset's times follow from its row numbers"


def _rates(subject: Subject, contract: Contract) -> str:
    lack = _clocks(subject, contract)
    return lack or ("" if any(r.rate_hz for r in contract.topics.values()) else "no contract gives a rate")


def _required(subject: Subject, contract: Contract) -> str:
    undecoded = any(t.undecoded for s in subject.recordings for t in s.topics.values())
    return "" if contract.topics or contract.cameras or undecoded else "no contract names topics"


def _motion(subject: Subject, contract: Contract) -> str:
    found = any(s.find(p.measured) and s.find(p.commanded) for s in subject.recordings for p in contract.motion)
    return "" if found else "no measured signal with its command (motion in the contract)"


def _limits(subject: Subject, contract: Contract) -> str:
    return "" if contract.limits else "no limits in the contract, no URDF in the recording"


def _units(subject: Subject, contract: Contract) -> str:
    return _limits(subject, contract) and _motion(subject, contract)


def _cameras(subject: Subject, contract: Contract) -> str:
    return "" if any(s.cameras for s in subject.recordings) else "there is no camera"


def _two_cameras(subject: Subject, contract: Contract) -> str:
    return "" if any(len(s.cameras) > 1 for s in subject.recordings) else "there are no two cameras"


def _moving_cameras(subject: Subject, contract: Contract) -> str:
    return _cameras(subject, contract) or _motion(subject, contract)


def _pictures(subject: Subject, contract: Contract) -> str:
    ours = any(s.episode is not None for s in subject.recordings)
    return "" if ours else _cameras(subject, contract)


def _several(subject: Subject, contract: Contract) -> str:
    return ("" if len(subject.recordings) > 1 else "one recording has no other to equal") or _motion(subject, contract)


def _splits(subject: Subject, contract: Contract) -> str:
    return "" if len({s.split for s in subject.recordings if s.split}) > 1 else "there is one split at most"


def _outcome(subject: Subject, contract: Contract) -> str:
    if contract.success is None:
        return "no task says when an attempt succeeds"
    found = any(outcome.perceived(s) for s in subject.recordings)
    return "" if found else "object, mark and tool are not recorded"


def _consent(subject: Subject, contract: Contract) -> str:
    if not contract.consent:
        return "the contract asks for none"
    return "the consents of a version are asked for when it is built" if subject.tables is not None else ""


def _evaluation(subject: Subject, contract: Contract) -> str:
    return "" if contract.evaluation is not None else "no evaluation in the contract"


def _dataset(subject: Subject, contract: Contract) -> str:
    return "" if subject.tables is not None else "it is no dataset"


def _stats(subject: Subject, contract: Contract) -> str:
    lack = _dataset(subject, contract)
    return lack or ("" if subject.tables and subject.tables.stats else "there is no meta/stats.json")


def _recording(subject: Subject, contract: Contract) -> str:
    return "" if subject.tables is None else "it is no recording"


CHECKS: MappingProxyType[str, Entry] = MappingProxyType({
    "truncated": Entry(_each(messages.truncated), _recording, "the file ends early, or was recovered after it did"),
    "summary": Entry(_each(messages.summary), _recording, "the summary does not count what the file holds"),
    "consent": Entry(_each(outcome.consent), _consent, "no consent record, or a person under 'simulated'"),
    "coverage": Entry(_each(messages.coverage), _required, "a required topic or camera is missing, of another type, "
                      "begins late, ends early, or does not decode"),
    "rates": Entry(_each(timing.rates), _rates, "a topic speaks faster or slower than the contract says"),
    "gaps": Entry(_each(timing.gaps), _clocks, "a steady topic falls silent"),
    "jitter": Entry(_each(timing.jitter), _clocks, "a steady topic speaks unevenly"),
    "clock-offset": Entry(_each(timing.clock_offset), _clocks, "stamps of one topic lie off those of the others"),
    "clock-drift": Entry(_each(timing.clock_drift), _clocks, "a topic's clock runs away from the recorder's"),
    "clock-jump": Entry(_each(timing.clock_jump), _clocks, "time goes back, or two clocks part at a bound"),
    "sequence": Entry(_each(messages.sequence), _clocks, "running numbers left out, there twice, or out of order"),
    "finite": Entry(_each(values.finite), _nothing, "NaN or infinity"),
    "limits": Entry(_each(values.limits), _limits, "a joint beyond its limits, or faster than it can be"),
    "units": Entry(_each(values.units), _units, "degrees for radians, millimetres for metres"),
    "frozen": Entry(_each(motion.frozen), _motion, "a joint stands still to the bit while its command moves"),
    "lag": Entry(_each(motion.lag), _motion, "the motion runs too far behind its command, or ahead of it"),
    "answer": Entry(_each(motion.answer), _motion, "the motion is not the one that was commanded"),
    "spikes": Entry(_each(motion.spikes), _motion, "a reading jumps out and back within one sample"),
    "black-camera": Entry(_each(cameras.black_camera), _cameras, "pictures show nothing, or do not decode"),
    "frozen-camera": Entry(_each(cameras.frozen_camera), _moving_cameras, "the same picture while the robot moves"),
    "swapped-cameras": Entry(swapped.swapped_cameras, _two_cameras, "two cameras show what the other one should"),
    "frames": Entry(video.frames, _pictures, "fewer or more pictures or messages than rows"),
    "shifted-video": Entry(_each(video.shifted_video), _moving_cameras, "pictures move before or after the joints do"),
    "success-flag": Entry(_each(outcome.success_flag), _outcome, "the recorded outcome is not what was perceived"),
    "duplicates": Entry(identity.duplicates, _several, "episodes with the same motion"),
    "leaks": Entry(identity.leaks, _splits, "held-out episodes that training knows, by descent or by content"),
    "evaluation": Entry(fit.evaluation, _evaluation, "robot, task, rate, features or actions are not those that the "
                        "policy is judged by"),
    "statistics": Entry(fit.statistics, _stats, "meta/stats.json does not fit the rows"),
    "tables": Entry(fit.tables, _dataset, "totals, lengths, numbers or times do not fit each other; changed bytes"),
})
"""Check name -> how it is done. Add one: a function of a subject and a contract, and an entry here."""
