"""One candidate as the control loop sees it: a process to ask, which may be gone, silent or wrong at any moment."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

import pipeline
from pipeline.protocols import Array
from pipeline.shadow import wire
from pipeline.shadow.limits import Limits
from pipeline.shadow.sizes import ARM, Sizes

type Word = Literal["starting", "running", "late", "broken", "slow", "hung", "crashed", "refused"]

OVER: frozenset[Word] = frozenset({"slow", "hung", "crashed", "refused"})
"""A candidate with such a word is asked nothing more."""
ENDING_S = 2.0
"""How long a process that has closed its socket may take to end [s]."""
BUFFER_BYTES = 1 << 20
"""Asked for, for each direction of a socket; a kernel may give less (208 KiB by default)."""


@dataclass(frozen=True, slots=True)
class _Open:
    """A question that was asked."""

    rows: slice
    """Where its answer goes."""
    asked_s: float


class Candidate:
    """A process, the questions that it has not answered, and what became of it.

    Args:
        id: of the policy.
        file: its ONNX file.
        limits: what it may take.
        patient: whether the clock waits for it.
        sizes: what it is asked.
    """

    def __init__(self, id: str, file: Path, limits: Limits, *, patient: bool, sizes: Sizes = ARM) -> None:
        self.id, self.fence = id, ""
        """What it gave up, as its process says once it is ready."""
        self.word: Word = "starting"
        """What became of it."""
        self._why, self._limits, self._patient, self._width = "", limits, patient, sizes.action
        self._late = self._lost = self._broken = self._ticks = 0
        self._odd = self._full = False
        """Whether it answered something that is not finite at this tick; whether a question was lost."""
        self._open: dict[int, _Open] = {}
        self._actions, self._first = np.zeros((0, self._width)), 0
        self._waited_s = 0.0
        self._ending_s: float | None = None
        """Since when its socket is closed."""
        self._process: subprocess.Popen[bytes] | None = None
        self._started_s = time.monotonic()
        self._line, theirs = _pair()
        with theirs:
            try:
                self._process = _start(file, theirs, limits, sizes, idle=not patient)
            except OSError as error:  # no memory, or no process left
                self._end("crashed", f"it could not be started: {error.strerror}")

    def state(self, *, wait: bool = False) -> str:
        """The word, and why; of one that is ending it is known once its process is gone, which may be waited for."""
        if wait and self._ending_s is not None:
            self._closed(wait=True)
        return f"{self.word}: {why}" if (why := self._why or self._counts()) else self.word

    @property
    def pid(self) -> int | None:
        """Id of the process, while it is asked anything."""
        return self._process.pid if self._process and self.word not in OVER else None

    @property
    def asked(self) -> bool:
        """Whether a question of this tick is open."""
        return self.word not in OVER and any(number >= self._first for number in self._open)

    def tick(self, packets: list[tuple[int, slice, bytes]], rows: int) -> None:
        """Ask the questions of one tick, for `rows` attempts in all; what does not fit on the way is lost."""
        self._actions, self._first = np.full((rows, self._width), np.nan), packets[0][0] if packets else self._first
        self._odd = self._full = False
        self.hear()
        if self.word in OVER:
            return
        now, self._ticks = time.monotonic(), self._ticks + 1
        for number, place, packet in packets:
            try:
                self._line.send(packet)
                self._open[number] = _Open(place, now)
            except BlockingIOError:
                self._full = True
            except OSError:
                self.hear()  # it may have said why it ends
                return
        self._lost += self._full
        self._check_time(now)

    def hear(self) -> None:
        """Take in what it has said; never waits."""
        while self.word not in OVER and self._ending_s is None:
            try:
                packet = self._line.recv(wire.MAX_PACKET)
            except BlockingIOError:
                return
            except ConnectionResetError:
                continue  # told once, before what it said last
            except OSError:
                packet = b""
            if not packet:
                self._closed()
                return
            self._take(packet)
        if self._ending_s is not None:
            self._closed()

    def settle(self) -> Array:
        """Its actions for this tick, NaN where there is none; from here on an answer is too late."""
        if self.word in OVER:
            self._actions[:] = np.nan
        elif self.word != "starting":
            self._late += self.asked
            self.word = "late" if self.asked or self._full else "broken" if self._odd else "running"
        return self._actions

    def waited(self, seconds: float) -> None:
        """Count that the clock waited for it, and end it where that is too long."""
        self._waited_s += seconds
        self._check_time(time.monotonic())
        if self._waited_s > self._limits.patience_s:
            self._end("slow", f"the clock waited {self._limits.patience_s:g} s for it in {self._ticks} ticks")

    def fileno(self) -> int:
        """Its socket."""
        return self._line.fileno()

    def close(self) -> None:
        """End the process and wait until it is gone."""
        self._line.close()
        if self._process is not None:
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(10)

    def _take(self, packet: bytes) -> None:
        try:
            said = wire.said(packet, self._width)
            question = self._open.pop(said.number, None) if said.kind in (wire.ANSWER, wire.FAILED) else None
            if said.actions is not None and (question is None or _rows(question.rows) != said.rows):
                raise ValueError("an answer to no question")
        except ValueError as error:
            self._end("crashed", f"it says what no candidate says: {error}")
            return
        if said.kind == wire.READY and self.word == "starting":
            self.word, self.fence = "running", said.text
        elif said.kind == wire.REFUSED:
            self._end("refused", said.text)
        elif said.kind == wire.FAILED:
            self._end("crashed", said.text)
        elif said.actions is not None and question is not None and said.number >= self._first:
            whole = np.isfinite(said.actions).all(axis=1)
            self._broken, self._odd = self._broken + int((~whole).sum()), self._odd or not whole.all()
            self._actions[question.rows][whole] = said.actions[whole]

    def _check_time(self, now_s: float) -> None:
        """End it where it has been silent for too long."""
        if self.word == "starting":
            if now_s - self._started_s > self._limits.load_s:
                self._end("hung", f"not ready within {self._limits.load_s:g} s")
        elif self._open and self.word not in OVER:
            oldest = next(iter(self._open.values()))
            if now_s - oldest.asked_s > self._limits.answer_s:
                self._end("hung", f"no answer within {self._limits.answer_s:g} s")

    def _closed(self, *, wait: bool = False) -> None:
        """Its socket is closed: say how it ended, once that is known."""
        now = time.monotonic()
        self._ending_s = self._ending_s or now
        process = self._process
        if process is None or self.word in OVER:
            return
        if self._patient or wait:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(ENDING_S)
        if (code := process.poll()) is not None:
            self._end("crashed", _cause(code, self._limits))
        elif now - self._ending_s > ENDING_S:
            self._end("crashed", "it closed its socket")

    def _end(self, word: Word, why: str) -> None:
        """Ask it nothing more; the first reason stays."""
        if self.word in OVER:
            return
        self.word, self._why = word, why
        self._open.clear()
        if self._process is not None:
            self._process.kill()

    def _counts(self) -> str:
        told = ((self._late, "late"), (self._lost, "lost on the way"), (self._broken, "not finite"))
        return ", ".join(f"{count} answer{'s' * (count > 1)} {how}" for count, how in told if count)


def _pair() -> tuple[socket.socket, socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    for end in (ours, theirs):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
    return ours, theirs


def _start(file: Path, line: socket.socket, limits: Limits, sizes: Sizes, *,
           idle: bool) -> "subprocess.Popen[bytes]":
    """A child that gets our code, one socket and a file's name: none of our variables, no terminal."""
    root = str(Path(pipeline.__file__).parents[1])
    environment = {"PYTHONPATH": root, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1",
                   "PATH": os.environ.get("PATH", os.defpath)}
    numbers = (line.fileno(), os.getpid(), limits.memory_bytes, limits.cpu_s, int(idle), sizes.kind, sizes.state,
               sizes.environment)
    command = [sys.executable, "-P", "-m", "pipeline.shadow.child", *map(str, numbers), str(file.absolute())]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                            env=environment, start_new_session=True, pass_fds=(line.fileno(),))


def _rows(place: slice) -> int:
    return place.stop - place.start


def _cause(code: int, limits: Limits) -> str:
    if code == -signal.SIGXCPU:
        return f"takes more than {limits.cpu_s:g} s of CPU time"
    return f"its process died ({signal.Signals(-code).name})" if code < 0 else f"its process ended (exit code {code})"
