"""What the tests of robots share: LeRobot plugins, a terminal with a child in it, and a person who reads and types."""

import os
import pty
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from flows.teleop.devices import TeleopOrder, open_robot
from pipeline.store import Store
from schemas.consent import Consent

ROOT, PLUGINS = Path(__file__).parents[2], Path(__file__).parent / "plugins"
N = r"(-?[\d.]+)"
STATUS = re.compile(rf"{N}/\d+ +{N} s (\w+).*?hand z {N} open {N}"
                    rf"  cube x {N} y {N} z {N} turn {N}  mark x {N} y {N}\x1b")


class Terminal:
    """`hardcase` in a pseudo-terminal: its status comes from the screen, keys go to its keyboard."""

    def __init__(self, store: Path, arguments: tuple[str, ...]) -> None:
        self._master, slave = pty.openpty()
        path = os.pathsep.join([str(ROOT), str(PLUGINS)])
        env = os.environ | {"HARDCASE_STORE": str(store), "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "NO_COLOR": "1"}
        self.process = subprocess.Popen([sys.executable, "-m", "flows.cli", *arguments], stdin=slave, stderr=slave,
                                        stdout=subprocess.PIPE, env=env, cwd=ROOT, start_new_session=True)
        os.close(slave)
        self.screen = ""

    def look(self, seconds: float = 0.05) -> str:
        """What came onto the screen since the last look; waits for something to come."""
        if not select.select([self._master], [], [], seconds)[0]:
            return ""
        try:
            text = os.read(self._master, 1 << 16).decode(errors="replace")
        except OSError:  # nobody holds the other end any more
            return ""
        self.screen += text
        return text

    def wait_for(self, text: str, seconds: float = 40.0) -> None:
        end = time.monotonic() + seconds
        while text not in self.screen:
            assert time.monotonic() < end and self.process.poll() is None, f"no {text!r} on: {self.screen[-800:]}"
            self.look()

    def press(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def status(self) -> tuple[str, dict[str, float]] | None:
        """Who drives, and the numbers of the newest whole status line."""
        lines = self.screen[-600:].split("\r")
        for line in reversed(lines):
            if found := STATUS.search(line):  # a line that is still being written has no end yet
                names = ("attempt", "s", "z", "open", "x", "y", "down", "turn", "to_x", "to_y")
                values = [found[k] for k in (1, 2, 4, 5, 6, 7, 8, 9, 10, 11)]
                return found[3], dict(zip(names, map(float, values), strict=True))
        return None

    def end(self, seconds: float = 30.0) -> tuple[int, str]:
        """Exit code and standard output, once the child has ended by itself."""
        end = time.monotonic() + seconds
        while self.process.poll() is None:
            assert time.monotonic() < end, f"still running: {self.screen[-800:]}"
            self.look()
        while self.look(0.2):
            pass
        return self.process.returncode, self.process.stdout.read().decode()

    def hang_up(self) -> None:
        """As a connection that breaks."""
        os.close(self._master)
        self._master = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        if self._master >= 0:
            os.close(self._master)


class Person:
    """Picks the cube up and puts it on the mark, as somebody would who reads the line and presses keys."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal, self._step, self._since, self._pause = terminal, "above", 0, 0

    def work(self, *, seconds: float = 60.0, until: str = "") -> None:
        """Drive until the child has ended, or somebody else drives, or the step `until` is reached."""
        end, seen = time.monotonic() + seconds, ""
        while self._terminal.process.poll() is None and self._step != until:
            assert time.monotonic() < end, f"step {self._step}: {self._terminal.screen[-300:]}"
            if not self._terminal.look():
                continue
            status = self._terminal.status()
            if status is None or status[0] != "YOU" or str(status) == seen:
                continue
            seen = str(status)
            keys = self._keys(status[1])
            if keys:
                self._terminal.press(keys)

    def _keys(self, s: dict[str, float]) -> str:
        self._since += 1
        match self._step:
            case "above":
                self._next("down", abs(s["x"]) < 0.6 and abs(s["y"]) < 0.6 and abs(s["turn"]) < 6)
                return self._towards(s["x"], s["y"]) + self._turn(s["turn"])
            case "down":
                self._next("close", s["down"] > -0.6)
                return self._towards(s["x"], s["y"]) + self._axis("r", "f", s["down"])
            case "close":
                self._next("lift", self._since > 25)
                return "c" if self._since == 1 else ""
            case "lift":
                self._next("carry", s["z"] > 9)
                return self._axis("r", "f", 10 - s["z"])
            case "carry":
                self._next("lower", abs(s["to_x"]) < 0.7 and abs(s["to_y"]) < 0.7)
                return self._towards(s["to_x"], s["to_y"])
            case "lower":
                self._next("open", s["z"] < 2.6)
                return self._towards(s["to_x"], s["to_y"]) + self._axis("r", "f", 2.2 - s["z"])
            case "open":
                self._next("away", self._since > 20)
                return "o" if self._since == 1 else ""
            case _:
                return self._axis("r", "f", 14 - s["z"])

    def _next(self, step: str, ready: bool) -> None:
        if ready:
            self._step, self._since = step, 0

    def _towards(self, x: float, y: float) -> str:
        return self._axis("w", "s", x) + self._axis("a", "d", y)

    def _turn(self, degrees: float) -> str:
        return self._axis("q", "e", degrees / 8)

    @staticmethod
    def _axis(more: str, less: str, error: float) -> str:
        """A key for a coarse error [cm], its capital for a fine one, none for none."""
        key = more if error > 0 else less
        return key if abs(error) > 2 else key.upper() if abs(error) > 0.35 else ""


@pytest.fixture
def terminal(tmp_path):
    """Starts `hardcase teleop ARGUMENTS` in a pseudo-terminal, with the test's own store."""
    opened: list[Terminal] = []

    def start(*arguments: str) -> Terminal:
        opened.append(Terminal(tmp_path / "store", ("teleop", *arguments)))
        return opened[-1]

    yield start
    for one in opened:
        one.close()


@pytest.fixture
def person():
    return Person


@pytest.fixture
def store(tmp_path):
    """The test's store, with the consent of p7."""
    with Store.open(tmp_path / "store", create=True) as opened:
        opened.add_consent(Consent(id="form-7", operator="p7", site="lab", purposes=("training",), given="2026-01-01",
                                   expires="2099-01-01"))
        yield opened


@pytest.fixture
def plugins(monkeypatch):
    """LeRobot finds the tests' plugins as it finds every other: by the names of distributions on the path."""
    monkeypatch.syspath_prepend(str(PLUGINS))
    return PLUGINS


@pytest.fixture
def simulated():
    """Makes a simulated arm that does not wait for the clock, and the starts of a session."""

    def make(name: str = "arm", session: int = 0, **options):
        driven = open_robot(TeleopOrder(robot=name, speed=0, **options), session)
        return driven.robot, driven.scene_of

    return make


@pytest.fixture(scope="module")
def plugins_everywhere():
    """The plugins for as long as a module's own fixtures live."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PLUGINS))
        yield PLUGINS
