"""Run functions on files that nobody trusts, in child processes with limits on memory, CPU and wall time.

Arguments and results are JSON, large results are files that the function writes. Whatever happens to a child,
the parent gets one error that names file, limit and mend.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pipeline
from pipeline import errors
from pipeline.errors import HardcaseError, RecordingError
from pipeline.recording.errors import SPLIT

MAX_ANSWER = 16 << 20
"""Longest answer [B]; what is larger goes into files."""
_HOSTILE = f"do not open it elsewhere, it may be made to harm; if it is right, {SPLIT}"
_REPORT = "fetch it again; if it is right, report it as a fault of the reader"
_TIMES = {-signal.SIGPROF: "CPU time", -signal.SIGXCPU: "CPU time", -signal.SIGALRM: "wall time"}


@dataclass(frozen=True, slots=True)
class Limits:
    """What a child may take for one job."""

    memory_bytes: int = 512 << 20
    """Address space, the interpreter's 130 MB included [B]."""
    cpu_s: float = 3.0
    """[s]"""
    wall_s: float = 30.0
    """Where a child waits for a disk or a busy machine [s]."""

    @classmethod
    def of(cls, path: Path, *, bytes_a_second: float = 4e6) -> "Limits":
        """Limits that grow with a file, so that a large one may take its time.

        Args:
            path: the file.
            bytes_a_second: CPU time that each byte is worth; reading alone reaches 20 times the default.
        """
        size = path.stat().st_size if path.exists() else 0
        return cls(cpu_s=3.0 + size / bytes_a_second, wall_s=30.0 + 4 * size / bytes_a_second)


class Children:
    """A pool of children, each started when it is first needed, and replaced when it died."""

    def __init__(self, count: int = 1) -> None:
        self._count = count
        self._all = [_Child() for _ in range(count)]
        self._free: SimpleQueue[_Child] = SimpleQueue()
        for child in self._all:
            self._free.put(child)

    def __enter__(self) -> "Children":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all children."""
        for child in self._all:
            child.end()

    def call(self, function: Callable[..., Any], *arguments: object, where: Path, limits: Limits | None = None) -> Any:
        """Run a function of ours, a module's own, in a child that is free; from any thread.

        Args:
            function: takes and returns what JSON knows.
            arguments: what it takes; paths as text.
            where: the file that it reads.
            limits: what it may take; by the file's size without.

        Raises:
            HardcaseError: what the function raised, or a RecordingError that names the limit it met.
        """
        limits = limits or Limits.of(where)
        job = {"function": f"{function.__module__}:{function.__qualname__}", "arguments": arguments,
               "memory_bytes": limits.memory_bytes, "cpu_s": limits.cpu_s, "wall_s": limits.wall_s}
        line = json.dumps(job).encode() + b"\n"
        child = self._free.get()
        try:
            used, answer = child.used, child.ask(line, limits.wall_s)
            if used and answer == {"failed": "MemoryError"}:  # what earlier jobs left must not decide
                answer = child.ask(line, limits.wall_s)
        finally:
            self._free.put(child)
        return _value(answer, where, limits)

    def map(self, function: Callable[..., Any], files: Sequence[Path], *arguments: object) -> Iterator[Any]:
        """Run a function on each file's path and what else it takes; results in order, HardcaseErrors among them."""

        def one(path: Path) -> Any:
            try:
                return self.call(function, str(path), *arguments, where=path)
            except HardcaseError as error:
                return error

        with ThreadPoolExecutor(self._count) as threads:
            yield from threads.map(one, files)


class _Child:
    """One child process, or none yet."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self.used = False
        """The process had a job before."""

    def ask(self, line: bytes, wall_s: float) -> dict[str, Any]:
        """The answer to a job: 'result', 'refused', 'failed' or, where the child died, 'died'."""
        process = self._process = self._process or _start()
        self.used = True
        try:
            answer = _exchange(process, line, time.monotonic() + wall_s + 2)
        except TimeoutError:
            answer = {"died": -signal.SIGALRM}
        except (OSError, ValueError):  # the pipe is closed, or what came is no answer: it died or is about to
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(2)
            answer = {"died": process.poll()}
        if "died" in answer or "failed" in answer:
            self.end()
        return answer

    def end(self) -> None:
        """Kill the process, if there is one."""
        process, self._process, self.used = self._process, None, False
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe:
                    with contextlib.suppress(OSError):
                        pipe.close()


def _start() -> "subprocess.Popen[bytes]":
    """A child that gets our code and nothing else: none of our variables, no folder of the caller's on its path."""
    root = str(Path(pipeline.__file__).parents[1])
    environment = {"PYTHONPATH": root, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1",
                   "PATH": os.environ.get("PATH", os.defpath)}
    command = [sys.executable, "-P", "-m", "pipeline.logs.worker"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                            env=environment, start_new_session=True)


def _exchange(process: "subprocess.Popen[bytes]", line: bytes, until: float) -> dict[str, Any]:
    """Send a job and wait for its answer; OSError or ValueError where the child is gone, TimeoutError past `until`."""
    assert process.stdin and process.stdout
    process.stdin.write(line)
    process.stdin.flush()
    pipe, answer = process.stdout.fileno(), bytearray()
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    while not answer.endswith(b"\n"):
        if not poll.poll(max(0.0, until - time.monotonic()) * 1000):
            raise TimeoutError
        if not (piece := os.read(pipe, 1 << 16)):
            raise ValueError("no answer")
        if len(answer) > MAX_ANSWER:
            return {"failed": f"it names and declares more than {MAX_ANSWER >> 20} MiB"}
        answer += piece
    return json.loads(answer)


def _value(answer: dict[str, Any], where: Path, limits: Limits) -> Any:
    """The result, or the error that the answer stands for."""
    if "result" in answer:
        return answer["result"]
    if "refused" in answer:
        name, what, place, mend = answer["refused"]
        raise getattr(errors, name)(what, where=place, mend=mend)
    cause = answer.get("failed")
    if cause == "MemoryError":
        raise RecordingError(f"takes more than {limits.memory_bytes >> 20} MiB of memory to read; quarantined",
                             where=where, mend=_HOSTILE)
    if cause is not None:
        raise RecordingError(f"cannot be read: {cause}", where=where, mend=_REPORT)
    code = answer["died"]
    if code in _TIMES:
        seconds = limits.wall_s if code == -signal.SIGALRM else limits.cpu_s
        raise RecordingError(f"takes more than {seconds:.3g} s of {_TIMES[code]} to read; quarantined", where=where,
                             mend=_HOSTILE)
    how = signal.Signals(-code).name if isinstance(code, int) and code < 0 else f"exit code {code}"
    raise RecordingError(f"the process that read it died ({how}); quarantined", where=where, mend=_REPORT)
