import os
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.store import StepManifest, Store
from schemas.summary import LoopResult

ROOT = Path(__file__).parents[2]


class CountingLoop:
    """The real command line over a loop whose stages only count; see counting.py."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.store, self.log = folder, folder / "store", folder / "log"
        self.environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "HARDCASE", "COUNTING", "COLUMNS"))},
            "HARDCASE_STORE": str(self.store),
            "COUNTING_LOG": str(self.log),
            "PYTHONPATH": str(ROOT),
        }

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, str(ROOT / "tests/flows/counting.py"), *arguments],
            env={**self.environment, **environment},
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=240)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def lines(self) -> list[str]:
        return self.log.read_text().splitlines() if self.log.exists() else []

    def wait_for(self, line: str) -> None:
        wait_until(lambda: line in self.lines(), f"{line!r} in the log")

    def servers(self) -> list[int]:
        """Prefect servers that were started for this store and are alive."""
        home = f"PREFECT_HOME={self.store / '.prefect'}".encode()
        found = []
        for process in Path("/proc").iterdir():
            try:
                command, environment = (process / "cmdline").read_bytes(), (process / "environ").read_bytes()
                if b"embedded_server" in command and home in environment:
                    found.append(int(process.name))
            except (OSError, ValueError):
                continue
        return found


class RealLoop:
    """The real command line on a store of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.store = folder, folder / "store"
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "HARDCASE", "COLUMNS", "DISPLAY"))}
        own = {"HARDCASE_STORE": str(self.store), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        self.environment = clean | own

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, "-m", "flows.cli", *arguments], cwd=ROOT, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=self.environment)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments)
        out, err = process.communicate(timeout=200)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def result(self) -> LoopResult:
        return LoopResult.model_validate_json((self.folder / "result.json").read_text())

    def manifests(self) -> dict[tuple[str, int, str], tuple[int, float]]:
        """(run, generation, stage) -> rowid and wall time: both change where a stage is done again."""
        try:
            catalog = sqlite3.connect(f"file:{self.store / 'catalog.db'}?mode=ro", uri=True)
            rows = catalog.execute("SELECT rowid, json FROM step").fetchall()
            catalog.close()
        except sqlite3.OperationalError:  # the store is not there yet
            return {}
        steps = [(rowid, StepManifest.model_validate_json(text)) for rowid, text in rows]
        return {(s.run, s.generation, s.stage): (rowid, s.wall_s) for rowid, s in steps}

    def says(self, run: str) -> list[tuple[object, ...]]:
        """Everything that the manifests of a run say, times left out."""
        with Store.open(self.store) as store:
            return [(s.generation, s.stage, s.inputs, s.outputs, s.code) for s in store.steps(run)]


def wait_until(true: Callable[[], bool], what: str, limit_s: float = 60) -> None:
    end = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < end, f"{what} did not come within {limit_s} s"
        time.sleep(0.05)


@pytest.fixture
def counting(tmp_path: Path) -> CountingLoop:
    return CountingLoop(tmp_path)


@pytest.fixture(scope="session")
def counting_in() -> type[CountingLoop]:
    return CountingLoop


@pytest.fixture
def real(tmp_path: Path) -> RealLoop:
    """The real command line, on an empty store."""
    return RealLoop(tmp_path)


@pytest.fixture(scope="session")
def turned(tmp_path_factory: pytest.TempPathFactory) -> RealLoop:
    """One whole smoke loop with its control, on real parts; for tests that only read it."""
    loop = RealLoop(tmp_path_factory.mktemp("turned"))
    loop.done = loop.run("loop", "--recipe", "smoke", "--control", "--json", str(loop.folder / "result.json"))
    assert loop.done.returncode == 0, loop.done.stderr
    return loop


@pytest.fixture(scope="session")
def run(turned: RealLoop) -> str:
    """Id of that loop; its control is another run."""
    with Store.open(turned.store) as store:
        return next(id for id, info in store.runs().items() if not info.control)


@pytest.fixture
def eventually() -> Callable[..., None]:
    return wait_until


@pytest.fixture
def hardcase(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """The real command line, on an empty store."""

    def call(*arguments: str, cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "HARDCASE"))}
        return subprocess.run(
            [sys.executable, "-m", "flows.cli", *arguments],
            env={**clean, "HARDCASE_STORE": str(tmp_path / "store"), "PYTHONPATH": str(ROOT), **environment},
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=240,
        )

    return call


@pytest.fixture
def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]
