"""Prefect as a service on one machine: server, work pool, deployments and worker by one command. `make serve`"""

import ctypes
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from flows.service.embedded_server import PR_SET_PDEATHSIG
from pipeline.errors import HardcaseError
from pipeline.store import store_root

CHECKOUT = Path(__file__).parents[1]
POOL = "hardcase"
START_LIMIT_S = 180.0  # a fresh database on a busy machine takes 20 s


class Service:
    """Environment and child processes of one `make serve`."""

    def __init__(self, home: Path, port: int, **settings: str) -> None:
        self.url = f"http://127.0.0.1:{port}/api"
        self._port = port
        self._children: list[tuple[str, subprocess.Popen[bytes]]] = []
        self.environment = {
            **os.environ,
            "DO_NOT_TRACK": "1",
            "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
            "PREFECT_HOME": str(home.absolute()),
            "PREFECT_API_URL": self.url,
            "PREFECT_SERVER_UI_API_URL": self.url,  # the page must find the API on a port other than 4200, too
            "HARDCASE_CHECKOUT": str(CHECKOUT),
            "HARDCASE_STORE": str(store_root().absolute()),
            "PYTHONPATH": os.pathsep.join([str(CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])]),
            **settings,
        }
        home.mkdir(parents=True, exist_ok=True)

    def spawn(self, *command: str) -> None:
        """Start a lasting child, `prefect COMMAND`; it ends with this process, however that ends."""
        libc = ctypes.CDLL(None)
        child = subprocess.Popen(
            [*PREFECT, *command],
            env=self.environment,
            cwd=CHECKOUT,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=lambda: libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM),
        )
        self._children.append((" ".join(command[:2]), child))

    def call(self, *command: str) -> str:
        """Run `prefect COMMAND` to its end and hand back what it printed.

        Raises:
            HardcaseError: it failed; with its last line.
        """
        done = subprocess.run(
            [*PREFECT, "--no-prompt", *command], env=self.environment, cwd=CHECKOUT, capture_output=True, text=True
        )
        if done.returncode:
            lines = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()
            where = f"prefect {' '.join(command)}"
            raise HardcaseError(lines[-1], where=where, mend=f"PREFECT_API_URL={self.url} {where}, to see all of it")
        return done.stdout

    def wait_until_up(self) -> None:
        """Wait for the server's health.

        Raises:
            HardcaseError: it ended, or is not up after three minutes.
        """
        end_s = time.monotonic() + START_LIMIT_S
        while time.monotonic() < end_s:
            self.require()
            try:
                with urllib.request.urlopen(f"{self.url}/health", timeout=2):
                    return
            except OSError:
                time.sleep(0.2)
        raise HardcaseError("Prefect's server does not come up", where=self.url, mend="is the machine overloaded?")

    def require(self) -> None:
        """Raise if a child has ended."""
        for name, child in self._children:
            if child.poll() is not None:
                raise HardcaseError(
                    f"`prefect {name}` ended with exit code {child.returncode}",
                    where=self.url,
                    mend=f"is port {self._port} in use? another one: make serve PORT={self._port + 1}",
                )

    def stop(self) -> None:
        """End the children, last first."""
        for _, child in reversed(self._children):
            if child.poll() is None:
                child.terminate()
            try:
                child.wait(timeout=15)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


PREFECT = (sys.executable, "-m", "prefect")


@contextmanager
def serving(home: Path, port: int, *, worker: bool = True, **settings: str) -> Iterator[Service]:
    """Server, pool, both deployments of prefect.yaml and a worker while the block runs.

    Args:
        home: PREFECT_HOME of the service: its database.
        port: of API and page, on 127.0.0.1 only.
        worker: also start the worker that runs what is queued.
        settings: further environment, such as PREFECT_SERVER_SERVICES_SCHEDULER_LOOP_SECONDS.
    """
    service = Service(home, port, **settings)
    try:
        service.spawn("server", "start", "--host", "127.0.0.1", "--port", str(port))
        service.wait_until_up()
        service.call("work-pool", "create", POOL, "--type", "process", "--overwrite")
        service.call("deploy", "--all")
        if worker:
            service.spawn("worker", "start", "--pool", POOL, "--type", "process", "--limit", "1")
        yield service
    finally:
        service.stop()


def serve(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of API and page on 127.0.0.1.")] = 4200,
) -> None:
    """Serve until Ctrl-C.

    Example: python -m flows.serve --port 4300
    """
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        typer.echo("starting Prefect's server, work pool, deployments and worker ...")
        with serving(store_root() / ".prefect-server", port) as service:
            typer.echo(f"page: http://127.0.0.1:{port}\nin another terminal:\n  export PREFECT_API_URL={service.url}")
            typer.echo("  prefect deployment run closed-loop/closed-loop\nCtrl-C stops everything")
            while True:
                service.require()
                time.sleep(1)
    except KeyboardInterrupt:
        typer.echo("stopped")
    except HardcaseError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    typer.run(serve)
