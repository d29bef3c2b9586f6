import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

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
        out, err = process.communicate(timeout=120)
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
            timeout=120,
        )

    return call


@pytest.fixture
def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]
