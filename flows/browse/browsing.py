"""`hardcase browse`: episodes in Rerun, served from this machine to this machine, until somebody ends it."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from flows.browse.query import Chosen, choose
from pipeline.errors import ConfigError, HardcaseError
from pipeline.store import Store

if TYPE_CHECKING:
    from flows.browse.making import Beside, Made, Making
    from pipeline.browsing.catalog import Catalog
    from pipeline.policies.onnx_policy import OnnxPolicy

BATCH = 25
"""Episodes that are made before they appear in the table."""


@dataclass(frozen=True, slots=True)
class BrowseOrder:
    """What was asked for on the command line."""

    words: tuple[str, ...] = ()
    beside: "Beside | None" = None
    policy: str | None = None
    """Whose predictions are laid over the episodes."""
    web: bool = False
    port: int = 0
    limit: int = 500
    as_json: bool = False


def browse(order: BrowseOrder, root: Path) -> None:
    """Show episodes until the viewer is closed, or Ctrl-C or SIGTERM comes; nothing runs on afterwards.

    Args:
        order: what was asked for.
        root: folder of the store.

    Raises:
        HardcaseError: nothing matches, or there is no display and no --web.
    """
    if not order.web and not has_display():
        raise ConfigError("there is no display to open the viewer on", where="this machine",
                          mend=f"see it in a browser: hardcase browse {' '.join((*order.words, '--web'))}")
    with Store.open(root, reserve_mb=0) as store, ended_by_signals() as ended:
        chosen = choose(store, order.words, order.limit)
        if order.beside and not chosen.single:
            raise ConfigError("one episode is shown beside others at a time", where=f"--beside {order.beside}",
                              mend=f"name it: hardcase browse {chosen.episodes[-1].id} --beside {order.beside}")
        with showing(store, order, chosen, ended) as (address, viewer):
            _tell(address, order, len(chosen.episodes))
            if viewer is None:
                ended.wait()
            else:
                while viewer.poll() is None and not ended.wait(0.2):
                    pass


@contextmanager
def showing(store: Store, order: BrowseOrder, chosen: Chosen,
            ended: threading.Event) -> Generator[tuple[str, "subprocess.Popen[bytes] | None"]]:
    """Catalog and viewer while the body runs; gives the address to open, and the viewer's process if it is our child.

    Args:
        store: an open store.
        order: what was asked for.
        chosen: the episodes.
        ended: set to stop making recordings.
    """
    from flows.browse.making import Making
    from pipeline.browsing.catalog import serving
    from pipeline.browsing.web import native_viewer, web_viewer

    making = Making(store, _policy(store, order.policy))
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hardcase-browse-")))
        catalog = stack.enter_context(serving())
        start = _fill(catalog, making, order, chosen, scratch, ended)
        if order.web:
            yield stack.enter_context(web_viewer(catalog.url, start, order.port)), None
        else:
            yield start, stack.enter_context(native_viewer(start))


def _fill(catalog: "Catalog", making: "Making", order: BrowseOrder, chosen: Chosen, scratch: Path,
          ended: threading.Event) -> str:
    """Make and register everything; where a viewer begins."""
    from pipeline.browsing.blueprint import beside, of_episode
    from pipeline.browsing.outline import together

    if order.beside:
        made = making.beside(chosen.episodes[0], order.beside)
        name = f"beside {order.beside}"
        catalog.add(name, [made.entry])
        catalog.arrange(name, beside(made.outlines), scratch)
        return catalog.page(name, made.entry.id)
    left_out: list[str] = []
    tables: dict[str, list[Made]] = {}
    waiting: list[Made] = []
    for k, episode in enumerate(chosen.episodes):
        if ended.is_set():
            break
        try:
            waiting.append(making.episode(episode))
        except HardcaseError as error:
            if chosen.single:
                raise
            left_out.append(f"{episode.id}: {error.what}")
        if len(waiting) == BATCH or k == len(chosen.episodes) - 1:
            _register(catalog, waiting, tables)
            waiting = []
            _progress(k + 1, len(chosen.episodes), order)
    if not tables:
        raise ConfigError(f"none of {len(chosen.episodes)} episodes can be shown", where=left_out[0] if left_out else
                          "it was ended", mend="see what is wrong with it: hardcase check ID")
    for robot, mades in tables.items():
        catalog.arrange(robot, of_episode(together(made.outlines[""] for made in mades)), scratch)
    _say_left_out(left_out, chosen)
    largest = max(tables, key=lambda robot: len(tables[robot]))
    return catalog.page(largest, chosen.episodes[0].id if chosen.single else None)


def _register(catalog: "Catalog", mades: Sequence["Made"], tables: dict[str, list["Made"]]) -> None:
    for robot in dict.fromkeys(made.robot for made in mades):
        group = [made for made in mades if made.robot == robot]
        catalog.add(robot, [made.entry for made in group])
        tables.setdefault(robot, []).extend(group)


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextmanager
def ended_by_signals() -> Generator[threading.Event]:
    """An event that Ctrl-C, SIGTERM and a connection that breaks set; a second one interrupts at once."""
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        if ended.is_set():
            raise KeyboardInterrupt
        ended.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _policy(store: Store, name: str | None) -> "tuple[str, OnnxPolicy] | None":
    if name is None:
        return None
    from flows.teleop.devices import open_policy
    from pipeline.policies.onnx_policy import OnnxPolicy

    policy, _, id = open_policy(name, store)
    if not isinstance(policy, OnnxPolicy) or id is None:
        raise ConfigError(f"{name} predicts nothing from what was recorded", where=f"--policy {name}",
                          mend="name champion, or the id of a policy")
    return id, policy


def _progress(done: int, of: int, order: BrowseOrder) -> None:
    if sys.stderr.isatty() and not order.as_json and of > BATCH:
        print(f"\r{done} of {of} episodes ready", end="\n" if done == of else "", file=sys.stderr, flush=True)


def _say_left_out(left_out: Sequence[str], chosen: Chosen) -> None:
    if left_out:
        print(f"{len(left_out)} episodes cannot be shown, the first: {left_out[0]}", file=sys.stderr)
    if chosen.more:
        print(f"{chosen.more} older episodes match as well: ask for more with --limit", file=sys.stderr)


def _tell(address: str, order: BrowseOrder, episodes: int) -> None:
    if order.as_json:
        print(json.dumps({"address": address, "episodes": episodes}), flush=True)
    elif order.web:
        print(f"{episodes} episodes at {address}   (Ctrl-C ends it)", flush=True)
    else:
        print(f"{episodes} episodes in the viewer   (closing it, or Ctrl-C, ends it)", flush=True)
