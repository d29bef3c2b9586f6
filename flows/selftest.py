"""hardcase selftest: make clean material, plant known faults, and show what the checks say of both."""

import json
from collections.abc import Collection, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.progress import Progress

from flows.selftest_material import make_material
from pipeline.check.table import CHECKS
from pipeline.errors import ConfigError
from pipeline.files import atomic
from pipeline.selftest.judging import Result, run
from pipeline.selftest.material import Judge, Material, Seen
from pipeline.selftest.table import FAULTS
from schemas.contract import Contract
from stages.check import Item, check

PASSED, FAILED = 0, 1


def run_selftest(*, seed: int = 0, out: Path | None = None, keep: Path | None = None) -> tuple[str, int]:
    """Plant every fault of FAULTS and check 100 clean episodes.

    Args:
        seed: decides the clean episodes and where and how large faults are.
        out: where to write the result as JSON.
        keep: an empty folder in which the files stay; else they are deleted.

    Returns:
        What to print, and the exit code: 0 all faults caught and nothing clean accused, 1 otherwise.

    Raises:
        HardcaseError: the material cannot be made, or `keep` is not empty.
    """
    with _folder(keep) as folder, Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("recording clean episodes", total=None)
        material = make_material(folder / "clean", seed)
        bar.update(task, total=len(material.clean) + 1 + len(FAULTS))
        result = run(material, FAULTS, judge_with(CHECKS), folder / "planted", seed=seed,
                     progress=lambda what: bar.update(task, description=what, advance=1))
    if out is not None:
        with atomic(out) as stream:
            stream.write((json.dumps(as_json(result), indent=1, ensure_ascii=False) + "\n").encode())
    return "\n".join(told(result, material)), PASSED if result.passed else FAILED


@contextmanager
def _folder(keep: Path | None) -> Generator[Path]:
    """Where the files lie: a new folder that stays, or one that is deleted at the end."""
    if keep is None:
        with TemporaryDirectory(prefix="hardcase-selftest-") as folder:
            yield Path(folder)
        return
    if keep.exists() and (not keep.is_dir() or any(keep.iterdir())):
        raise ConfigError("the folder is not empty", where=keep, mend="name a new one: --keep FOLDER")
    yield keep


def judge_with(names: Collection[str]) -> Judge:
    """The checks of these names, as `hardcase check` runs them over recordings and datasets of ours."""
    def judge(paths: Sequence[Path], contract: Contract) -> list[Seen]:
        done = check([Item(path, path.name, trusted=True) for path in paths], contract, names=names)
        return [Seen(c.verdict.findings if c.verdict else (), c.error.what if c.error else "") for c in done]
    return judge


def as_json(result: Result) -> dict[str, Any]:
    """The result for machines."""
    return {
        "passed": result.passed,
        "faults": [{"name": p.name, "what": p.fault.what, "on": p.fault.on, "expected": list(p.fault.expect),
                    "caught_by": list(p.caught_by), "also": list(p.also), "said": p.said} for p in result.planted],
        "clean_episodes": result.clean_episodes,
        "clean_datasets": result.clean_datasets,
        "false_alarms": len(result.alarms),
        "alarms": [{"name": a.where.name, "said": a.said} for a in result.alarms],
    }


def told(result: Result, material: Material) -> list[str]:
    """A line for each fault, one for each false alarm, then the sums."""
    rows = [(p.name, ", ".join(p.caught_by) or "MISSED", p.said) for p in result.planted]
    widths = [max(len(row[k]) for row in rows) for k in range(2)]
    lines = [f"{name.ljust(widths[0])}  {by.ljust(widths[1])}  {said}" for name, by, said in rows]
    lines += [f"FALSE ALARM  {a.where.parent.name}/{a.where.name}: {a.said}" for a in result.alarms]
    pictures = "rendered" if material.rendered else "drawn: nothing renders here (hardcase doctor)"
    return [*lines, "", f"{len(result.planted) - len(result.missed)} of {len(result.planted)} faults caught",
            f"{len(result.alarms)} false alarms on {result.clean_episodes} clean episodes and "
            f"{result.clean_datasets} clean datasets; pictures were {pictures}"]
