"""hardcase selftest: make clean material, plant known faults, and see what the checks say of both."""

import json
from collections.abc import Collection, Generator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.progress import Progress

from flows.selftest.display import as_json, told
from flows.selftest.material import make_material
from pipeline.check.table import CHECKS
from pipeline.errors import ConfigError
from pipeline.files import atomic
from pipeline.selftest.dataset_referees import DATASET_REFEREES, ask_dataset_referees
from pipeline.selftest.judging import Result, run
from pipeline.selftest.material import Judge, Seen
from pipeline.selftest.opinions import Asked
from pipeline.selftest.referees import REFEREES, ask_referees
from pipeline.selftest.table import FAULTS
from schemas.contract import Contract
from stages.check import Item, check

PASSED, FAILED = 0, 1


def run_selftest(*, seed: int = 0, out: Path | None = None, keep: Path | None = None, referees: bool = False,
                 names: Collection[str] = CHECKS.keys()) -> tuple[str, int]:
    """Plant every fault of FAULTS and check 100 clean episodes.

    Args:
        seed: decides the clean episodes and where and how large faults are.
        out: where to write the result as JSON.
        keep: a new folder in which the files stay; else they are deleted.
        referees: ask checkers that others wrote, too.
        names: the checks that take part; all of them by default.

    Returns:
        What to print, and the exit code: 0 all faults caught and nothing clean accused, 1 otherwise.

    Raises:
        HardcaseError: the material cannot be made, `keep` is not empty, or a referee is not installed.
    """
    if referees:
        _require_referees()
    with _folder(keep) as folder, Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("recording clean episodes", total=None)
        material = make_material(folder / "clean", seed)
        of_recordings = sum("dataset" not in fault.on for fault in FAULTS.values())
        asking = (of_recordings + len(DATASET_REFEREES)) * referees
        bar.update(task, total=len(material.clean) + 1 + len(FAULTS) + asking)

        def show(what: str) -> None:
            bar.update(task, description=what, advance=1)

        result = run(material, FAULTS, judge_with(names), folder / "planted", seed=seed, progress=show)
        asked = (ask_referees(material, result.planted, show) | ask_dataset_referees(material, result.planted, show)
                 if referees else None)
    if out is not None:
        with atomic(out) as stream:
            stream.write((json.dumps(as_json(result, asked), indent=1, ensure_ascii=False) + "\n").encode())
    return "\n".join(told(result, asked)), exit_code(result, asked)


def exit_code(result: Result, asked: Asked | None = None) -> int:
    """1 if a fault was missed, or if we or a referee accused something clean."""
    return PASSED if result.passed and not (asked and asked.alarms) else FAILED


def judge_with(names: Collection[str]) -> Judge:
    """The checks of these names, as `hardcase check` runs them over recordings and datasets of ours."""
    def judge(paths: Sequence[Path], contract: Contract) -> list[Seen]:
        done = check([Item(path, path.name, trusted=True) for path in paths], contract, names=names)
        return [Seen(c.verdict.findings if c.verdict else (), c.error.what if c.error else "") for c in done]
    return judge


def _require_referees() -> None:
    """Return when all referees are installed."""
    packages = [*REFEREES, *(referee.package for referee in DATASET_REFEREES.values())]
    if missing := [name for name in packages if find_spec(name) is None]:
        raise ConfigError(f"not installed: {', '.join(missing)}", where="--referees",
                          mend="install what the tests need: uv sync")


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
