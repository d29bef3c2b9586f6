"""The threads behind a live recording: one makes chunks and writes them, one keeps the disk up to date."""

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.recording import cdr
from pipeline.recording.live_file import CHUNK_BYTES, LiveFile

CHUNK_S = 0.150
"""Age of the oldest message at which a chunk is closed [s]; at 0.25 s the worst of 10 kills would lose more than that
every second time. Source: docs/results.md, kills."""
SYNC_S = 1.0
"""Between two fdatasyncs [s]: what a power cut may take; a kill of the process loses nothing that was written."""
QUEUE_BYTES = 64 << 20
"""What may wait for the disk [B]: 3 s of two cameras of 640 x 480 at 50 Hz."""
_LOW = 0.75
"""Part of the queue that pictures may fill; the rest is kept for what the robot did."""
_WAKE_BYTES = 8 << 20
"""Bytes waiting at which the writer does not wait for the chunk's time [B]."""

type Body = NDArray[np.generic] | bytes | Callable[[int], bytes]
"""A tick's vector, a picture, a payload, or what makes a payload of the stamp [ns]."""


class Item(NamedTuple):
    """One call of the control thread, on its way to the file."""

    topic: str
    """Topic, or "tick" for all messages of a tick."""
    tick: int
    log_ns: int
    stamp_ns: int
    body: Body


class LiveWriter:
    """Takes items without ever waiting for the disk, and puts them into a file that is open already.

    Args:
        handle: the file, empty, locked; owned by the caller.
        file: makes its bytes.
        lay: lays an item into the file; runs in the writer's thread.
        clock: log time now [ns].
        queue_bytes: see QUEUE_BYTES.
        chunk_s: see CHUNK_S.
    """

    def __init__(self, handle: int, file: LiveFile, lay: Callable[[Item], None], clock: Callable[[], int], *,
                 queue_bytes: int = QUEUE_BYTES, chunk_s: float = CHUNK_S) -> None:
        self._handle, self._file, self._lay, self._clock = handle, file, lay, clock
        self._room, self._chunk_s = queue_bytes, chunk_s
        self.error: Exception | None = None
        """The first that the disk or an encoder reported; nothing is taken after it."""
        self.dropped: Counter[str] = Counter()
        """Topic -> messages that found the queue full."""
        self._told: Counter[str] = Counter()
        self._lock, self._wake, self._stop = threading.Lock(), threading.Event(), threading.Event()
        self._items: deque[Item] = deque()
        self._held = 0
        self._newest = 0
        self._write()  # header, metadata and attachments: before anything else, so that an error shows at the start
        self._threads = [threading.Thread(target=self._write_on, name="recording", daemon=True),
                         threading.Thread(target=self._sync_on, name="recording-sync", daemon=True)]
        for thread in self._threads:
            thread.start()

    def put(self, item: Item, size: int, *, low: bool = False) -> bool:
        """Queue an item; False where it was dropped because the queue is full or the recording has failed.

        Args:
            item: what to write.
            size: bytes it holds while it waits [B].
            low: give way first: pictures, of which the next one is nearly as good.
        """
        with self._lock:
            self._newest, over = item.tick, self.error is not None or self._stop.is_set()
            if over or self._held + size > (self._room * _LOW if low else self._room):
                self.dropped[item.topic] += 1
                return False
            self._items.append(item)
            self._held += size
            first, full = len(self._items) == 1, self._held > _WAKE_BYTES
        if first or full:
            self._wake.set()
        return True

    def finish(self) -> None:
        """Write what waits and end both threads; the error, if there was one, stays in `error`."""
        self._stop.set()
        self._wake.set()
        for thread in self._threads:
            thread.join()

    def _write_on(self) -> None:
        while True:
            if not self._stop.is_set():
                self._wake.wait()
            self._wake.clear()
            self._rest()
            stopping = self._stop.is_set()  # asked before the drain: what was queued before the stop is in it
            try:
                self._drain()
            except Exception as error:
                self._latch(error)
            if stopping or self.error is not None:
                return

    def _rest(self) -> None:
        """Wait until the oldest item's chunk is due, or too much waits, or the end."""
        due = time.monotonic() + self._chunk_s
        while not self._stop.is_set() and self._held <= _WAKE_BYTES and (left := due - time.monotonic()) > 0:
            self._wake.wait(left)
            self._wake.clear()

    def _drain(self) -> None:
        with self._lock:
            items, self._items, self._held = self._items, deque[Item](), 0
            new = self.dropped - self._told
            self._told, tick = Counter(self.dropped), self._newest
        while items:
            try:
                self._lay(items[0])
            except Exception:
                with self._lock:
                    self.dropped.update(item.topic for item in items)
                raise
            items.popleft()
            if self._file.chunk_bytes >= CHUNK_BYTES:
                self._file.seal()
                self._write()
        for topic, count in new.items():
            now = self._clock()
            text = f"{count} messages on {topic} dropped: the disk is slower than the robot"
            self._file.add("/events", tick, now, now, cdr.log(now, 40, "recorder", text))
        self._file.seal()
        self._write()

    def _write(self) -> None:
        """Hand the file's new bytes to the system, all of them."""
        write_all(self._handle, self._file.take())

    def _sync_on(self) -> None:
        while not self._stop.wait(SYNC_S) and self.error is None:
            try:
                os.fdatasync(self._handle)
            except OSError as error:
                self._latch(error)

    def _latch(self, error: Exception) -> None:
        with self._lock:
            if self.error is None:
                self.error = error
            for item in self._items:
                self.dropped[item.topic] += 1
            self._items.clear()
            self._held = 0
        self._wake.set()


def write_all(handle: int, data: bytes) -> None:
    """Write every byte or raise OSError: a short write is followed by the rest, which tells why."""
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]


def close_quietly(handle: int) -> None:
    """Close a file whose error was told already, or that was synced long ago."""
    with suppress(OSError):
        os.close(handle)
