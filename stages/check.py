"""Check: recordings and datasets are held against a contract, each with a verdict of its own."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.check.contract import completed
from pipeline.check.folder import is_dataset, read_folder
from pipeline.check.identity import Motion, duplicate, motion_of, same_motion
from pipeline.check.initial import from_log
from pipeline.check.load import read_recording
from pipeline.check.run import check as run_checks
from pipeline.check.signals import Signals, Subject
from pipeline.check.table import CHECKS
from pipeline.errors import HardcaseError, RecordingError
from pipeline.files import sha256, short_id
from pipeline.logs.child import Children, Limits
from pipeline.logs.inspection import inspect
from schemas.contract import Contract
from schemas.finding import CheckVerdict, Finding

WHAT = "name a .mcap recording, the folder of a LeRobot dataset, or the id of an episode or version"
BYTES_A_SECOND = 1e6
"""CPU time that a child gets for each byte: a tenth of the speed at which recordings with cameras are checked."""
MEMORY_BYTES = 2 << 30
"""Address space of a child that checks: Arrow and video decoders reserve far more than they use."""


@dataclass(frozen=True, slots=True)
class Item:
    """Something to check."""

    path: Path
    name: str
    """What it is called in findings: a file's name, or an id."""
    trusted: bool = False
    """Ours, from the store: read in this process; anybody's file is read in a limited child."""


@dataclass(frozen=True, slots=True)
class Checked:
    """What became of one item: a verdict, or why it could not be read."""

    item: Item
    verdict: CheckVerdict | None
    error: HardcaseError | None = None


def check(items: Sequence[Item], contract: Contract, *, names: Collection[str] = CHECKS.keys(),
          progress: Callable[[int, int], None] | None = None) -> list[Checked]:
    """Check items one by one; recordings are also compared with those before them, for duplicates.

    An item that cannot be read is named with its reason, and the others go on.

    Args:
        items: recordings and datasets.
        contract: what is expected of each of them.
        names: the checks to run; all of them by default.
        progress: called as (items done, items in all).
    """
    done: list[Checked] = []
    motions: dict[int, Motion] = {}
    with Children() as children:
        for k, item in enumerate(items):
            try:
                verdict, motion = _one(item, contract, names, children)
            except HardcaseError as error:
                done.append(Checked(item, None, error))
                continue
            done.append(Checked(item, verdict))
            if motion is not None:
                motions[k] = motion
            if progress is not None:
                progress(k + 1, len(items))
    return _compared(done, motions, contract) if "duplicates" in names else done


def init(items: Sequence[Item], *, name: str = "default") -> Contract:
    """A contract that these good logs keep; at least one.

    Raises:
        HardcaseError: one of them cannot be read.
    """
    with Children() as children:
        for item in items:
            _gate(item.path, children)
        plain = children.call(contract_of, [str(i.path) for i in items], [i.name for i in items], name,
                              where=items[0].path, limits=_limits([i.path for i in items]))
    return Contract.model_validate_json(plain)


def read(path: Path, name: str) -> Subject:
    """A recording or dataset as checks see it.

    Raises:
        HardcaseError: it cannot be read, or is neither a recording nor a dataset.
    """
    if path.is_dir():
        if not is_dataset(path):
            raise RecordingError("a folder without meta/info.json is no dataset", where=path, mend=WHAT)
        return read_folder(path, name=name)
    if not path.exists():
        raise RecordingError("no such file or folder", where=path, mend=WHAT)
    return read_recording(path, name=name)


def verdict_of(path: str, name: str, contract: str, names: list[str]) -> dict[str, Any]:
    """One item's verdict and motion as JSON knows them: what a child does."""
    rules = Contract.model_validate_json(contract)
    subject = read(Path(path), name)
    motion = motion_of(subject.recordings[0], completed(rules, subject)) if subject.tables is None else None
    verdict = run_checks(subject, rules, names)
    return {"verdict": verdict.model_dump_json(), "motion": motion.plain() if motion else None}


def contract_of(paths: list[str], names: list[str], name: str) -> str:
    """A contract from good logs as JSON: what a child does."""
    subjects = [read(Path(path), called) for path, called in zip(paths, names, strict=True)]
    recordings: tuple[Signals, ...] = tuple(s for subject in subjects for s in subject.recordings)
    return from_log(Subject(name, subjects[0].digest, recordings, subjects[0].tables), name=name).model_dump_json()


def _one(item: Item, contract: Contract, names: Collection[str],
         children: Children) -> tuple[CheckVerdict, Motion | None]:
    arguments = str(item.path), item.name, contract.model_dump_json(), list(names)
    if not item.trusted:
        _gate(item.path, children)
    found: dict[str, Any] = verdict_of(*arguments) if item.trusted else children.call(
        verdict_of, *arguments, where=item.path, limits=_limits([item.path]))
    motion = Motion.of(found["motion"]) if found["motion"] else None
    return CheckVerdict.model_validate_json(found["verdict"]), motion


def _gate(path: Path, children: Children) -> None:
    """Read a recording once within the tight limits of any foreign file, so that what is hostile ends there."""
    if path.is_file():
        inspect(path, accept_truncated=True, children=children)


def _limits(paths: Sequence[Path]) -> Limits:
    files = (f for path in paths for f in (path.rglob("*") if path.is_dir() else [path]))
    size = sum(f.stat().st_size for f in files if f.is_file())
    return Limits(memory_bytes=MEMORY_BYTES, cpu_s=10 + size / BYTES_A_SECOND, wall_s=60 + 4 * size / BYTES_A_SECOND)


def _compared(done: list[Checked], motions: Mapping[int, Motion], contract: Contract) -> list[Checked]:
    """Verdicts of recordings with what the comparison with those before them adds."""
    first = {t.second: t for t in reversed(same_motion(list(motions.values()), contract.thresholds))}
    seen: list[str] = []
    for n, k in enumerate(motions):
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
