"""An embedded Prefect: its server as a child process on a loopback port, started early, stopped always.

Prefect's own ephemeral server starts inside the first flow call, keeps that
call waiting, has a start-up limit and is noisy when it ends. This child is
started before the heavy imports, so that both overlap; it inherits a socket
that already listens, so that no port is guessed and no start is polled: the
first request simply waits until the server accepts it.
"""

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from pipeline.errors import HardcaseError, StoreError

QUIET = {
    "DO_NOT_TRACK": "1",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_SERVER_UI_ENABLED": "false",
    "PREFECT_SERVER_REGISTER_BLOCKS_ON_START": "false",  # 1 s of a fresh start; nothing here uses blocks
    "PREFECT_LOGGING_LEVEL": "CRITICAL",
    "PREFECT_LOGGING_INTERNAL_LEVEL": "CRITICAL",
    "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
    "PREFECT_LOGGING_TO_API_ENABLED": "false",
    "PREFECT_RESULTS_PERSIST_BY_DEFAULT": "false",
    "PREFECT_CLIENT_MAX_RETRIES": "2",
}
"""Settings of both sides: offline, silent, nothing kept but the runs themselves."""


class EmbeddedPrefect:
    """The child server of one command."""

    def __init__(self, process: subprocess.Popen[bytes], url: str) -> None:
        self.process, self.url = process, url

    @classmethod
    def start(cls, home: Path) -> Self:
        """Start the child and return at once; call from the main thread.

        The kernel ends the child when the thread that started it ends
        (PR_SET_PDEATHSIG), so also after kill -9 of this process.

        Args:
            home: PREFECT_HOME of the child, created with its parents; holds Prefect's own SQLite file.

        Raises:
            StoreError: the folder cannot be made or written.
        """
        try:
            home.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            mend = "set PREFECT_HOME to a folder that you may write"
            raise StoreError(f"no folder for Prefect: {error.strerror}", where=home, mend=mend) from error
        with socket.create_server(("127.0.0.1", 0), backlog=128) as listener, (home / "server.log").open("wb") as log:
            url = f"http://127.0.0.1:{int(listener.getsockname()[1])}/api"
            settings = {**QUIET, "PREFECT_HOME": str(home.absolute()), "PREFECT_API_URL": url}
            process = subprocess.Popen(
                [sys.executable, "-m", "flows.service.embedded_server", str(listener.fileno()), str(os.getpid())],
                env={**os.environ, **settings, "PYTHONPATH": _import_path()},
                pass_fds=[listener.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,  # Ctrl-C of the terminal must not reach it before the flow has ended
            )
        logging.getLogger("EventsWorker").setLevel(logging.CRITICAL)  # outside of Prefect's own levels
        os.environ.update(settings)
        return cls(process, url)

    @property
    def alive(self) -> bool:
        """Whether the child still runs."""
        return self.process.poll() is None

    def require(self) -> None:
        """Raise the one-line reason if the child has ended; never waits."""
        if self.alive:
            return
        log = Path(os.environ["PREFECT_HOME"]) / "server.log"
        lines = log.read_text(errors="replace").strip().splitlines() if log.exists() else []
        reason = lines[-1] if lines else "no message"
        raise HardcaseError(
            f"the embedded Prefect server ended, exit code {self.process.returncode}: {reason}",
            where=log,
            mend="hardcase loop --resume goes on where it stopped; a damaged database: remove the folder of this log",
        )

    def stop(self) -> None:
        """Hand over the last events, then end the child; safe to call twice."""
        if self.alive:
            _drain_events()
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.process.wait()


@contextmanager
def embedded(store: Path) -> Iterator[EmbeddedPrefect | None]:
    """A Prefect API for the block: the user's own if PREFECT_API_URL is set (then None), else a child."""
    if os.environ.get("PREFECT_API_URL"):
        yield None
        return
    home = Path(os.environ.get("PREFECT_HOME") or store / ".prefect")
    server = EmbeddedPrefect.start(home)
    try:
        yield server
    finally:
        server.stop()


def _import_path() -> str:
    """PYTHONPATH of the child: this project first, so that it also runs from a checkout that is not installed."""
    root = str(Path(__file__).parents[2])
    return os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])


def _drain_events() -> None:
    """Let Prefect's background senders finish while the server still listens; nothing if Prefect was never imported."""
    worker = sys.modules.get("prefect.events.worker")
    if worker is not None:
        worker.EventsWorker.drain_all(timeout=3, at_exit=False)
