"""One loop on this machine, from the command line to the printed table."""

import contextlib
import gc
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from rich.console import Console

from flows.run.opening import Order, open_order
from flows.run.steps_api import LoopSteps
from flows.service.display import Display, show_result
from flows.service.embedded import EmbeddedPrefect, embedded
from flows.service.memory import MemoryWatch, frugal
from flows.service.running import Running, run_with
from pipeline.errors import HardcaseError
from pipeline.files import atomic
from schemas.summary import LoopResult


def run_loop(order: Order, root: Path, *, json: Path | None, browse: bool) -> LoopResult:
    """Turn the loop under an embedded Prefect, show it, and hand back its numbers.

    Progress goes to stderr, the result to stdout.

    Args:
        order: what to run.
        root: folder of the store; Prefect's own files lie in `.prefect` below it.
        json: file for the machine-readable result.
        browse: open the report in a browser.

    Raises:
        HardcaseError: a stage refused; what is finished stays finished.
        KeyboardInterrupt: by Ctrl-C or SIGTERM, after everything was closed.
    """
    frugal()
    with _signals_are_ctrl_c(), embedded(root) as server, MemoryWatch() as memory:
        with (
            open_order(order, root) as steps,
            Display(order.recipe, Console(stderr=True), control=order.control) as display,
            run_with(Running(steps, display, check=server.require if server else _nothing, peak_mb=memory.look)),
        ):
            _turn(server)
            result = _measured(steps, memory)
            verdict, page = steps.last_verdict(), steps.report_path()
        if json is not None:
            with atomic(json) as stream:
                stream.write(result.model_dump_json(indent=1).encode() + b"\n")
        show_result(Console(), result, verdict, page, legged=order.recipe.rl is not None)
        sys.stdout.flush()
    if browse and page is not None:
        open_page(page)
    return result


def _turn(server: EmbeddedPrefect | None) -> None:
    """Run the flow; if it fails because our server died, say that instead."""
    from prefect.settings import PREFECT_FLOWS_HEARTBEAT_FREQUENCY, temporary_settings

    from flows.loop import closed_loop

    gc.freeze()  # what was imported stays: no later collection need walk it again
    # Prefect waits up to a second for its heartbeat thread; nobody listens for heartbeats here
    quiet = temporary_settings({PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None}) if server else contextlib.nullcontext()
    try:
        with quiet:
            closed_loop()
    except HardcaseError:
        raise
    except Exception:
        if server is not None:
            server.require()
        raise


def _nothing() -> None:
    """The user's own server is the user's to watch."""


def _measured(steps: LoopSteps, memory: MemoryWatch) -> LoopResult:
    return steps.result().model_copy(update={"wall_s": since_start_s(), "peak_pss_mb": memory.look()})


def since_start_s() -> float:
    """Wall seconds since this process was started, interpreter and imports included."""
    started_ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_ticks / os.sysconf("SC_CLK_TCK")


def open_page(page: Path) -> None:
    """Show a page in the browser of the desktop; does nothing where there is no display."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        import webbrowser

        webbrowser.open(page.absolute().as_uri())


@contextlib.contextmanager
def _signals_are_ctrl_c() -> Iterator[None]:
    """SIGTERM ends a loop as cleanly as Ctrl-C; SIGINT does even where a shell started us with it ignored."""
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
