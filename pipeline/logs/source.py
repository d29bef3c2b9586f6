"""A file as a window that moves on: no more of it in memory than one record and a block."""

import os
import zlib
from io import FileIO

BLOCK = 1 << 20
"""Bytes read at once, at least."""


class Source:
    """A window over a file; `at` is where reading goes on in `data`."""

    def __init__(self, stream: FileIO, size: int) -> None:
        self._stream, self.size = stream, size
        self.data, self.at, self._base, self._crc = b"", 0, 0, 0

    @property
    def offset(self) -> int:
        """Where reading goes on in the file."""
        return self._base + self.at

    @property
    def left(self) -> int:
        """Bytes of the file that were not read yet."""
        return self.size - self.offset

    def holds(self, count: int) -> bool:
        """Whether the window has that many bytes from `at` on."""
        return len(self.data) - self.at >= count

    def fill(self, count: int) -> bool:
        """Make the window hold `count` bytes from `at` on, which becomes 0; False where the file is shorter."""
        if self.holds(count):
            return True
        if self.left < count:
            return False
        rest = self._turn()
        self.data = rest + self._read(self._base + len(rest), max(BLOCK, count - len(rest)))
        return self.holds(count)

    def skip(self, count: int) -> bool:
        """Read over bytes; False where the file is shorter."""
        if self.left < count:
            return False
        while count > (inside := len(self.data) - self.at):
            count -= inside
            self.at += inside
            if not self.fill(1):
                return False
        self.at += count
        return True

    def jump(self, count: int) -> bool:
        """Go over bytes without reading them, so that no CRC is known any more; False where the file is shorter."""
        if self.left < count:
            return False
        if self.holds(count):
            self.at += count
            return True
        self._base, self.at, self.data = self.offset + count, 0, b""
        return True

    def crc(self) -> int:
        """Of all bytes before `at` since the start or the last restart."""
        return zlib.crc32(memoryview(self.data)[: self.at], self._crc)

    def restart_crc(self) -> None:
        """Let the CRC start at `at`."""
        self.data, self._crc = self._turn(), 0

    def _turn(self) -> bytes:
        """Let the window start at `at`; returns what is left of it."""
        self._crc, rest = self.crc(), self.data[self.at :]
        self._base, self.at = self.offset, 0
        return rest

    def _read(self, offset: int, count: int) -> bytes:
        """Bytes at a place of the file; the file's own position is left alone, since others read it too."""
        first = os.pread(self._stream.fileno(), count, offset)
        if len(first) == count or not first:
            return first
        pieces, done = [first], len(first)
        while done < count and (piece := os.pread(self._stream.fileno(), count - done, offset + done)):
            pieces.append(piece)
            done += len(piece)
        return b"".join(pieces)
