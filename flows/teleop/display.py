"""What a person sees while they drive: one line that is written over, and a table at the end."""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.frames import ENVIRONMENT, STATE
from pipeline.protocols import Signals
from pipeline.recording.live import Closed
from pipeline.robots.session import Status

WHO = {"operator": "YOU", "policy": "POLICY", "reset": "RESET, Enter starts"}
_HAND = slice(STATE.index("ee_x"), STATE.index("ee_yaw") + 1)
_CUBE = slice(ENVIRONMENT.index("object_x"), ENVIRONMENT.index("object_yaw") + 1)
_MARK = slice(ENVIRONMENT.index("target_x"), ENVIRONMENT.index("target_y") + 1)


class StatusLine:
    """Writes one line a tick on a terminal; elsewhere one a second, and one where there is something new to know.

    Args:
        signals: columns of the robot.
        episodes: how many attempts were asked for.
        hz: control rate [Hz].
        stream: where to; standard error by default.
    """

    def __init__(self, signals: Signals, episodes: int, hz: float, stream: TextIO | None = None) -> None:
        self._signals, self._episodes, self._every = signals, episodes, max(1, round(hz))
        self._stream = stream or sys.stderr
        self._live, self._count, self._who, self._note = self._stream.isatty(), 0, "", ""

    def show(self, status: Status) -> None:
        """Write the line of this tick."""
        text = self.line(status)
        if self._live:
            self._write(f"\r{text[:_columns(self._stream) - 1]}\x1b[K")
        elif self._count % self._every == 0 or status.who != self._who or status.note not in ("", self._note):
            self._write(text + "\n")
        self._count, self._who, self._note = self._count + 1, status.who, status.note

    def line(self, status: Status) -> str:
        """The line of a tick: how far the hand has to go to cube and mark [cm, degrees], as far as the robot can tell.

        x grows forward (w), y to the left (a), z upward (r), turn counter-clockwise (q).
        """
        head = f"{status.attempt}/{self._episodes} {status.seconds:5.1f} s {WHO[status.who]}"
        return "  ".join(part for part in (head, self._pose(status), status.note) if part)

    def _pose(self, status: Status) -> str:
        state, seen = status.observation.state[0], status.observation.environment[0]
        if self._signals.state != STATE:
            return " ".join(f"{name.removesuffix('.pos')} {value:.1f}" for name, value in
                            zip(self._signals.state[:8], state, strict=False))
        hand = state[_HAND]
        text = f"hand z {100 * hand[2]:.1f} open {abs(100 * state[STATE.index('gripper')]):.1f}"
        if seen.size:
            x, y, z, turn = seen[_CUBE] - hand
            to_x, to_y = seen[_MARK] - hand[:2]
            text += (f"  cube x {100 * x:.1f} y {100 * y:.1f} z {100 * z:.1f} turn {np.degrees(turn):.0f}"
                     f"  mark x {100 * to_x:.1f} y {100 * to_y:.1f}")
        return text

    def end(self) -> None:
        """Leave the line standing and go on below it."""
        if self._live and self._count:
            self._write("\n")

    def _write(self, text: str) -> None:
        with suppress(OSError):  # a terminal that is gone must not break a recording off
            self._stream.write(text)
            self._stream.flush()


def attempts_table(attempts: Sequence[Closed]) -> Table:
    """One row an attempt: how it ended, how long it was, who commanded when, and what was lost."""
    table = Table(title="Attempts", title_justify="left")
    table.add_column("episode", no_wrap=True)
    for name in ("how it ended", "length", "who commanded"):
        table.add_column(name)
    for closed in attempts:
        episode, outcome = closed.episode, closed.episode.outcome
        ended = f"{outcome.label}, {outcome.reason or 'says the ' + outcome.judged_by}"
        if lost := sum(closed.dropped.values()):
            ended += f"; {lost} messages lost"
        parts = [f"{s.kind} {(s.stop - s.start) / episode.control_hz:.1f} s" for s in episode.segments]
        table.add_row(episode.id, ended, f"{episode.duration_s:.1f} s", "\n".join(parts))
    return table


def print_attempts(attempts: Sequence[Closed]) -> None:
    """The table, on standard output."""
    Console().print(attempts_table(attempts))


def _columns(stream: TextIO) -> int:
    try:
        return os.get_terminal_size(stream.fileno()).columns or 200
    except OSError:
        return 200
