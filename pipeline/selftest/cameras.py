"""Faults of cameras: swapped, black, frozen, late, early, torn, gone."""

import io
import struct
from collections.abc import Callable

import numpy as np
from mcap.records import Message
from numpy.typing import NDArray
from PIL import Image

from pipeline.selftest.filming import CAMERAS
from pipeline.selftest.log import Log

type Rng = np.random.Generator

TOPICS = tuple(f"/camera/{name}/image/compressed" for name in CAMERAS)
JPEG = b"\xff\xd8\xff"
LAG = 8
"""Frames; 0.4 s at 20 Hz."""


def jpeg_of(message: Message) -> bytes:
    """The picture in a sensor_msgs/CompressedImage."""
    return message.data[message.data.index(JPEG):]


def decoded(jpeg: bytes) -> NDArray[np.uint8]:
    """A picture as RGB, shape (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(jpeg)).convert("RGB"))


def with_jpeg(message: Message, jpeg: bytes) -> None:
    """Put another picture into a message; its header stays."""
    at = message.data.index(JPEG)
    message.data = message.data[:at - 4] + struct.pack("<I", len(jpeg)) + jpeg


def swapped(log: Log, rng: Rng) -> None:
    """The two cameras' plugs are exchanged: each driver publishes the other one's pictures under its own name."""
    _exchange(log, 0)


def swapped_on_the_way(log: Log, rng: Rng) -> None:
    """The two cameras change places in mid-recording, as after a reset of the USB bus."""
    _exchange(log, int(rng.uniform(0.4, 0.6) * len(log.of(TOPICS[0]))))


def _exchange(log: Log, first: int) -> None:
    for one, other in list(zip(*(log.of(topic) for topic in TOPICS), strict=True))[first:]:
        pictures = jpeg_of(one), jpeg_of(other)
        with_jpeg(one, pictures[1])
        with_jpeg(other, pictures[0])


def black(log: Log, rng: Rng) -> None:
    """One camera is black for 10 pictures: a loose cable."""
    messages = _one(log, rng)
    size = Image.open(io.BytesIO(jpeg_of(messages[0]))).size
    stream = io.BytesIO()
    Image.new("RGB", size, (3, 3, 3)).save(stream, "JPEG")
    start = int(rng.integers(len(messages) - 10))
    for message in messages[start:start + 10]:
        with_jpeg(message, stream.getvalue())


def frozen(log: Log, rng: Rng) -> None:
    """One camera repeats its last picture for 1 s, with new stamps, while the arm moves."""
    messages = _one(log, rng)
    start = int(rng.integers(3, max(4, len(messages) // 2 - 10)))
    picture = jpeg_of(messages[start])
    for message in messages[start:start + 21]:
        with_jpeg(message, picture)


def shifted(by: int) -> Callable[[Log, Rng], None]:
    """The pictures of one camera run some frames late, or early where `by` is negative; its stamps do not show it."""
    def plant(log: Log, rng: Rng) -> None:
        messages = _one(log, rng)
        pictures = [jpeg_of(m) for m in messages]
        for k, message in enumerate(messages):
            with_jpeg(message, pictures[min(max(k - by, 0), len(pictures) - 1)])
    return plant


def torn(log: Log, rng: Rng) -> None:
    """Three pictures of one camera lack their second half: a link that is too slow."""
    messages = _one(log, rng)
    for k in rng.choice(len(messages), 3, replace=False):
        jpeg = jpeg_of(messages[int(k)])
        with_jpeg(messages[int(k)], jpeg[:len(jpeg) // 2])


def camera_lost(log: Log, rng: Rng) -> None:
    """One camera was not recorded."""
    topic = str(rng.choice(TOPICS))
    log.drop(lambda m: log.topic(m) == topic)
    log.channels = {n: c for n, c in log.channels.items() if c.topic != topic}


def camera_dies(log: Log, rng: Rng) -> None:
    """One camera ends when 60 to 80 % of the attempt are over."""
    messages = _one(log, rng)
    gone = {id(m) for m in messages[int(rng.uniform(0.6, 0.8) * len(messages)):]}
    log.drop(lambda m: id(m) in gone)


def pictures_dropped(log: Log, rng: Rng) -> None:
    """One camera leaves out every eighth picture, and numbers on as if it had not."""
    messages = _one(log, rng)
    gone = {id(m) for m in messages[int(rng.integers(2, 8))::8]}
    log.drop(lambda m: id(m) in gone)
    kept = [m for m in messages if id(m) not in gone]
    for k, message in enumerate(kept):
        message.sequence = k


def _one(log: Log, rng: Rng) -> list[Message]:
    return log.of(str(rng.choice(TOPICS)))
