"""CDR, the bytes of ROS 2 messages: layouts that whole columns are laid into, and a bounded reader."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.dialect import WORLD

ENCAPSULATION = b"\x00\x01\x00\x00"
"""CDR version 1, little endian; alignment counts from the byte after it. Source: OMG DDSI-RTPS 2.3, 10.2."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A message of fixed length: all bytes that never change, and where those lie that do."""

    template: bytes
    """One payload, encapsulation included, zeros in the slots."""
    stamps: tuple[int, ...]
    """Offsets of builtin_interfaces/Time, 8 bytes each."""
    floats: tuple[tuple[int, int], ...]
    """(offset, count) of every run of float64."""

    def fixed(self) -> NDArray[np.bool_]:
        """Which bytes of the payload are the same in every message, shape (len(template),)."""
        mask = np.ones(len(self.template), np.bool_)
        for offset in self.stamps:
            mask[offset : offset + 8] = False
        for offset, count in self.floats:
            mask[offset : offset + 8 * count] = False
        return mask


class Builder:
    """Lays fields one after another, aligned as CDR asks."""

    def __init__(self) -> None:
        self._bytes = bytearray(ENCAPSULATION)
        self._stamps: list[int] = []
        self._floats: list[tuple[int, int]] = []

    def _align(self, size: int) -> None:
        self._bytes.extend(bytes(-(len(self._bytes) - 4) % size))

    def u8(self, value: int) -> Self:
        """One unsigned byte."""
        self._bytes.append(value)
        return self

    def u32(self, value: int) -> Self:
        """One unsigned 32-bit integer."""
        self._align(4)
        self._bytes += value.to_bytes(4, "little")
        return self

    def text(self, value: str) -> Self:
        """A string: its length with the closing zero byte, then both."""
        data = value.encode() + b"\0"
        self.u32(len(data))
        self._bytes += data
        return self

    def stamp(self, ns: int = 0) -> Self:
        """A time, as a slot; `ns` fills it where only one message is made."""
        self._align(4)
        self._stamps.append(len(self._bytes))
        self._bytes += struct.pack("<iI", *divmod(ns, 1_000_000_000))
        return self

    def floats(self, count: int) -> Self:
        """A run of `count` float64, as a slot; an empty run takes no padding."""
        if count:
            self._align(8)
            self._floats.append((len(self._bytes), count))
            self._bytes += bytes(8 * count)
        return self

    def layout(self) -> Layout:
        """The finished layout."""
        return Layout(bytes(self._bytes), tuple(self._stamps), tuple(self._floats))

    def payload(self) -> bytes:
        """The bytes of one message."""
        return bytes(self._bytes)


def joint_state(names: Sequence[str], *, position: bool = True, velocity: bool, effort: bool) -> Layout:
    """sensor_msgs/JointState; a column that is not recorded is an empty sequence."""
    builder = Builder().stamp().text("").u32(len(names))
    for name in names:
        builder.text(name)
    for present in (position, velocity, effort):
        count = len(names) if present else 0
        builder.u32(count).floats(count)
    return builder.layout()


def imu() -> Layout:
    """sensor_msgs/Imu: orientation x, y, z, w, its covariance, turning speed, its covariance, acceleration, its
    covariance; 37 values, of which a first covariance of -1 says that there is no such measurement.
    """
    return Builder().stamp().text("base").floats(37).layout()


def float64() -> Layout:
    """std_msgs/Float64."""
    return Builder().floats(1).layout()


def multi_array(label: str, width: int) -> Layout:
    """std_msgs/Float64MultiArray with one dimension, whose label says what the values are."""
    builder = Builder().u32(1).text(label).u32(width).u32(width).u32(0).u32(width)
    return builder.floats(width).layout()


def pose_stamped() -> Layout:
    """geometry_msgs/PoseStamped in the world frame: x, y, z, then the quaternion x, y, z, w."""
    return Builder().stamp().text(WORLD).floats(7).layout()


def tf_message(links: Iterable[str]) -> Layout:
    """tf2_msgs/TFMessage: every link in the world frame, each as x, y, z, then the quaternion x, y, z, w."""
    names = tuple(links)
    builder = Builder().u32(len(names))
    for name in names:
        builder.stamp().text(WORLD).text(name).floats(7)
    return builder.layout()


def text(value: str) -> bytes:
    """std_msgs/String."""
    return Builder().text(value).payload()


def log(ns: int, level: int, name: str, message: str) -> bytes:
    """rcl_interfaces/Log without a source position."""
    return Builder().stamp(ns).u8(level).text(name).text(message).text("").text("").u32(0).payload()


def compressed_image(ns: int, frame: str, kind: str, data: bytes) -> bytes:
    """sensor_msgs/CompressedImage; `frame` names the camera, `kind` the format, as 'jpeg'."""
    return Builder().stamp(ns).text(frame).text(kind).u32(len(data)).payload() + data


def joy(ns: int, axes: Sequence[float], buttons: Sequence[int]) -> bytes:
    """sensor_msgs/Joy: axes as float32, buttons as int32."""
    head = Builder().stamp(ns).text("").u32(len(axes)).payload()
    return head + struct.pack(f"<{len(axes)}fI{len(buttons)}i", *axes, len(buttons), *buttons)


class Cursor:
    """Reads CDR fields of one payload and never past its end; ValueError on anything that cannot be."""

    def __init__(self, payload: bytes) -> None:
        if payload[:4] != ENCAPSULATION:
            raise ValueError(f"payload starts with {payload[:4].hex()}, not little-endian CDR")
        self._data, self._at = payload, 4

    def _take(self, size: int, align: int) -> bytes:
        start = self._at + -(self._at - 4) % align
        if start + size > len(self._data):
            raise ValueError(f"field of {size} B at byte {start} of a payload of {len(self._data)} B")
        self._at = start + size
        return self._data[start : self._at]

    def u8(self) -> int:
        """One unsigned byte."""
        return self._take(1, 1)[0]

    def u32(self) -> int:
        """One unsigned 32-bit integer."""
        return int.from_bytes(self._take(4, 4), "little")

    def text(self) -> str:
        """A string; the closing zero byte is checked and dropped."""
        data = self._take(self.u32(), 1)
        if not data.endswith(b"\0"):
            raise ValueError("string without its closing zero byte")
        return data[:-1].decode()

    def stamp(self) -> int:
        """A time [ns]."""
        seconds, rest = struct.unpack("<iI", self._take(8, 4))
        return seconds * 1_000_000_000 + rest

    def floats(self, count: int) -> None:
        """Step over a run of float64."""
        if count:
            self._take(8 * count, 8)
