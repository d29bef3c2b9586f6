"""Keyboard: a terminal in raw mode as an input device; works over ssh, without a display.

A terminal reports that a key was pressed and, while it is held, that it repeats; it never reports a release. So every
report moves for HOLD_TICKS: a tap is one short step, and a held key moves without a break once its repeats come faster
than that (usual are 25 to 30 a second, after a pause of 0.25 to 0.6 s). A capital letter moves a quarter as fast.
"""

import os
import select
import sys
import termios
from contextlib import suppress
from types import MappingProxyType

from pipeline.errors import RobotError
from pipeline.protocols import Call, Command

HOLD_TICKS = 2
"""Ticks that one report of a motion key moves for."""
FINE = 0.25
"""Speed of a capital letter, and of Shift with an arrow."""
GRIP_TICKS = 10
"""Ticks that one report of a gripper key moves for: from open to closed and a little more."""
AXES = ("x", "y", "z", "yaw", "joint5", "joint6")

MOTION: MappingProxyType[str, tuple[int, float]] = MappingProxyType({
    "w": (0, 1.0), "s": (0, -1.0), "a": (1, 1.0), "d": (1, -1.0), "r": (2, 1.0), "f": (2, -1.0),
    "q": (3, 1.0), "e": (3, -1.0), "i": (4, 1.0), "k": (4, -1.0), "j": (5, 1.0), "l": (5, -1.0),
})
"""Key -> axis and direction."""
ARROWS: MappingProxyType[str, str] = MappingProxyType({
    "\x1b[A": "w", "\x1b[B": "s", "\x1b[D": "a", "\x1b[C": "d", "\x1bOA": "w", "\x1bOB": "s", "\x1bOD": "a",
    "\x1bOC": "d", "\x1b[1;2A": "W", "\x1b[1;2B": "S", "\x1b[1;2D": "A", "\x1b[1;2C": "D",
})
"""Escape sequence of an arrow key -> the letter it stands for. Source: xterm control sequences, PC-style keys."""
GRIP: MappingProxyType[str, float] = MappingProxyType({"o": 1.0, "c": -1.0})
"""Key -> direction of the gripper; the space bar goes the other way than last time."""
CALLS: MappingProxyType[str, Call] = MappingProxyType({
    "t": "take-over", "y": "success", "n": "failure", "u": "unknown", "\r": "next", "\n": "next", "x": "quit",
})
"""Key -> what it says to the session."""
BUTTONS = ("o", "c", "space", *(call for call in dict.fromkeys(CALLS.values())))
HELP = ("w/s forward/back  a/d left/right  r/f up/down  q/e turn  i/k j/l joints 5, 6  CAPITAL slow  space gripper  "
        "t take over  y success  n failure  u unknown  Enter next  x quit")


class Keyboard:
    """Implements pipeline.protocols.Teleoperator over a terminal.

    Args:
        handle: file number of the terminal; standard input where None.
    """

    name = "keyboard"
    raw_names = (AXES, BUTTONS)
    joints: tuple[str, ...] = ()

    def __init__(self, handle: int | None = None) -> None:
        self._handle = handle
        self._before: list[int | list[bytes | int]] | None = None
        self._moving: dict[int, tuple[float, int]] = {}
        self._grip, self._grip_ticks, self._opening = 0.0, 0, True
        self._rest = ""

    def connect(self) -> None:
        """Let keys come one by one and unseen; Ctrl-C stays a signal."""
        handle = sys.stdin.fileno() if self._handle is None else self._handle
        if not os.isatty(handle):
            raise RobotError("the keyboard needs a terminal", where="standard input",
                             mend="run it in a terminal, without a pipe; over ssh: ssh -t HOST hardcase teleop")
        self._before = termios.tcgetattr(handle)
        quiet = termios.tcgetattr(handle)
        quiet[3] &= ~(termios.ICANON | termios.ECHO)
        quiet[0] &= ~termios.ICRNL
        termios.tcsetattr(handle, termios.TCSANOW, quiet)
        self._handle = handle

    def disconnect(self) -> None:
        """Give the terminal back as it was."""
        if self._before is not None and self._handle is not None:
            with suppress(termios.error):  # a terminal that is gone needs nothing back
                termios.tcsetattr(self._handle, termios.TCSANOW, self._before)
            self._before = None

    def read(self) -> Command:
        """What was pressed since the last tick, and what still moves from before."""
        pressed = self._keys()
        calls: set[Call] = set()
        buttons: set[str] = set()
        for key in pressed:
            self._press(key, calls, buttons)
        axes = [0.0] * len(AXES)
        for axis, (share, ticks) in list(self._moving.items()):
            axes[axis] = share
            self._moving[axis] = (share, ticks - 1)
            if ticks <= 1:
                del self._moving[axis]
        grip = self._grip if self._grip_ticks > 0 else 0.0
        self._grip_ticks -= 1
        return Command(axes=tuple(axes), grip=grip, calls=frozenset(calls), raw_axes=tuple(axes),
                       raw_buttons=tuple(int(name in buttons) for name in BUTTONS))

    def _press(self, key: str, calls: set[Call], buttons: set[str]) -> None:
        if key.lower() in MOTION:
            axis, way = MOTION[key.lower()]
            self._moving[axis] = (way * (FINE if key.isupper() else 1.0), HOLD_TICKS)
        elif key in CALLS:
            calls.add(CALLS[key])
            buttons.add(CALLS[key])
            if CALLS[key] == "next":
                self._begin()
        elif key in GRIP or key == " ":
            buttons.add(key if key in GRIP else "space")
            self._opening = GRIP[key] > 0 if key in GRIP else not self._opening
            self._grip, self._grip_ticks = (1.0 if self._opening else -1.0), GRIP_TICKS

    def _begin(self) -> None:
        """Forget what still moves: an attempt begins with an open gripper and everything still."""
        self._moving.clear()
        self._grip_ticks, self._opening = 0, True

    def _keys(self) -> list[str]:
        """Whole keys that have arrived; the beginning of an escape sequence waits for its end."""
        handle = self._handle
        if handle is None or self._before is None:
            raise RobotError("the keyboard is not connected", where="keyboard", mend="call connect() before read()")
        text, self._rest = self._rest, ""
        while select.select([handle], [], [], 0)[0]:
            try:
                piece = os.read(handle, 1024)
            except OSError:
                piece = b""
            if not piece:
                raise RobotError("the terminal is gone", where="keyboard",
                                 mend="the attempt was kept; connect again: hardcase teleop")
            text += piece.decode("ascii", "ignore")
        return self._split(text)

    def _split(self, text: str) -> list[str]:
        found: list[str] = []
        while text:
            arrow = next((a for a in ARROWS if text.startswith(a)), None)
            if arrow is not None:
                found.append(ARROWS[arrow])
                text = text[len(arrow):]
            elif text[0] == "\x1b":
                if any(a.startswith(text) for a in ARROWS):
                    self._rest = text
                    break
                text = _after_escape(text)
            else:
                found.append(text[0])
                text = text[1:]
        return found


def _after_escape(text: str) -> str:
    """What follows an escape sequence that means nothing here. Source: ECMA-48, 5.4, control sequences."""
    if text[1:2] not in ("[", "O"):
        return text[1:]
    end = next((k for k, c in enumerate(text[2:], 2) if "@" <= c <= "~"), len(text) - 1)
    return text[end + 1:]
