"""Check: recordings and datasets are held against a contract, each with a verdict of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.check.contract import completed, from_log
from pipeline.check.folder import is_dataset, read_folder
from pipeline.check.identity import Motion, duplicate, motion_of, same_motion
from pipeline.check.load import read_recording
from pipeline.check.run import check as run_checks
from pipeline.check.signals import Signals, Subject
from pipeline.errors import HardcaseError, RecordingError
from pipeline.files import sha256, short_id
from schemas.contract import Contract
from schemas.finding import CheckVerdict, Finding

SHORT = "name a .mcap recording, the folder of a LeRobot dataset, or the id of an episode or version"


@dataclass(frozen=True, slots=True)
class Item:
    """Something to check."""

    path: Path
    name: str
    """What it is called in findings: a file's name, or an id."""


@dataclass(frozen=True, slots=True)
class Checked:
    """What became of one item: a verdict, or why it could not be read."""

    item: Item
    verdict: CheckVerdict | None
    error: HardcaseError | None = None


def check(items: Sequence[Item], contract: Contract, *,
          progress: Callable[[int, int], None] | None = None) -> list[Checked]:
    """Check items one by one; recordings are also compared with those before them, for duplicates.

    An item that cannot be read is named with its reason, and the others go on.

    Args:
        items: recordings and datasets.
        contract: what is expected of each of them.
        progress: called as (items done, items in all).
    """
    done: list[Checked] = []
    motions: dict[int, Motion] = {}
    for k, item in enumerate(items):
        try:
            subject = read(item)
        except HardcaseError as error:
            done.append(Checked(item, None, error))
            continue
        done.append(Checked(item, run_checks(subject, contract)))
        if subject.tables is None and (motion := motion_of(subject.recordings[0], completed(contract, subject))):
            motions[k] = motion
        if progress is not None:
            progress(k + 1, len(items))
    return _compared(done, motions, contract)


def read(item: Item) -> Subject:
    """The item as checks see it.

    Raises:
        HardcaseError: it cannot be read, or is neither a recording nor a dataset.
    """
    if item.path.is_dir():
        if not is_dataset(item.path):
            raise RecordingError("a folder without meta/info.json is no dataset", where=item.path, mend=SHORT)
        return read_folder(item.path, name=item.name)
    if not item.path.exists():
        raise RecordingError("no such file or folder", where=item.path, mend=SHORT)
    return read_recording(item.path, name=item.name)


def init(items: Sequence[Item], *, name: str) -> Contract:
    """A contract that these good logs keep.

    Raises:
        HardcaseError: one of them cannot be read.
    """
    subjects = [read(item) for item in items]
    recordings: tuple[Signals, ...] = tuple(s for subject in subjects for s in subject.recordings)
    return from_log(Subject(name, subjects[0].digest, recordings, subjects[0].tables), name=name)


def _compared(done: list[Checked], motions: Mapping[int, Motion], contract: Contract) -> list[Checked]:
    """Verdicts of recordings with what the comparison with those before them adds."""
    places = list(motions)
    first = {t.second: t for t in reversed(same_motion(list(motions.values()), contract.thresholds))}
    seen: list[str] = []
    for n, k in enumerate(places):
        verdict = done[k].verdict
        if verdict is None:
            continue
        if seen:
            found = (duplicate(verdict.name, first[n], contract),) if n in first else ()
            done[k] = replace(done[k], verdict=_with(verdict, found, sha256(" ".join(seen).encode())))
        seen.append(verdict.subject)
    return done


def _with(verdict: CheckVerdict, found: tuple[Finding, ...], beside: str) -> CheckVerdict:
    return CheckVerdict.model_validate({
        **dict(verdict), "id": short_id("check", verdict.subject, verdict.contract, verdict.code, beside),
        "beside": beside, "passed": verdict.passed and not found, "checks": (*verdict.checks, "duplicates"),
        "skipped": {name: lack for name, lack in verdict.skipped.items() if name != "duplicates"},
        "findings": (*verdict.findings, *found)})
