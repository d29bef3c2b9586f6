"""The child of the module embedded: Prefect's server on an inherited socket, as `embedded_server FD PARENT`."""

import asyncio
import ctypes
import gc
import os
import shutil
import signal
import socket
import sqlite3
import sys
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flows.service.memory import give_back

PR_SET_PDEATHSIG = 1  # linux/prctl.h
OFF = ("TRIGGERS", "EVENT_PERSISTER", "EVENT_LOGGER", "CANCELLATION_CLEANUP", "SCHEDULER", "LATE_RUNS", "FOREMAN")
"""Services of a server that schedules; this one only records what one flow does."""


def main() -> None:
    """Serve until SIGTERM, or until the parent is gone; or only prepare."""
    if sys.argv[1:] == ["prepare"]:
        prepare()
    else:
        die_with_parent(int(sys.argv[2]))
        serve(socket.socket(fileno=int(sys.argv[1])))


def prepare() -> None:
    """Make the template now, when the environment is installed, so that no first start has to wait for it."""
    if not _template().exists():
        with TemporaryDirectory() as home:
            os.environ.update({"PREFECT_HOME": home, "PREFECT_SERVER_ANALYTICS_ENABLED": "false", "DO_NOT_TRACK": "1"})
            _migrate(Path(home) / "prefect.db")


def serve(listener: socket.socket) -> None:
    """Prefect's API and the recorder of task runs, until SIGTERM."""
    os.environ.update({f"PREFECT_SERVER_SERVICES_{name}_ENABLED": "false" for name in OFF})
    gc.disable()  # nothing is freed while modules load; saves a tenth of the start
    os.environ.setdefault("PREFECT_SERVER_SERVICES_TASK_RUN_RECORDER_BATCH_SIZE", "200")  # of one, it ends behind
    home = Path(os.environ["PREFECT_HOME"])
    fresh = not (home / "prefect.db").exists()
    if fresh and _template().exists():
        _adopt(_template(), home / "prefect.db")
        os.environ["PREFECT_API_DATABASE_MIGRATE_ON_START"] = "false"
    import uvicorn
    from prefect.server.api.server import create_app

    if fresh and not _template().exists():
        _migrate(home / "prefect.db")
    # 'ephemeral' keeps the one service that turns events into task runs; a web-only server would lose them
    app: Any = create_app(ephemeral=True, final=True)
    gc.enable()
    gc.freeze()
    give_back()
    config = uvicorn.Config(app, log_level="critical", access_log=False, timeout_graceful_shutdown=2)
    uvicorn.Server(config).run(sockets=[listener])


def die_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the parent's starting thread ends; leave at once if it already has."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(0)


def _template() -> Path:
    """An empty database that Prefect's own migrations made once for this environment and version."""
    return Path(sys.prefix) / "var" / "hardcase" / f"prefect-{version('prefect')}.db"


def _adopt(template: Path, database: Path) -> None:
    """Begin with a copy of the template: 4 s of migrations less; whole or absent."""
    part = database.with_suffix(".part")
    shutil.copyfile(template, part)
    part.replace(database)


def _migrate(database: Path) -> None:
    """Run Prefect's migrations now and keep the empty result as the template; a read-only environment keeps none."""
    from prefect.server.database import provide_database_interface

    asyncio.run(provide_database_interface().create_db())
    part = _template().with_suffix(f".{os.getpid()}")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        with sqlite3.connect(database) as source, sqlite3.connect(part) as target:
            source.backup(target)
        part.replace(_template())
    except (OSError, sqlite3.Error):
        part.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
