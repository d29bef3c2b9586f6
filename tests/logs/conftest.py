"""Channels and batches made by hand, for decoders."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from pipeline.logs.stream import Batch, Channel


@pytest.fixture(scope="session")
def channel_of() -> Callable[..., Channel]:
    """A channel as a log would declare it."""

    def make(name: str, schema: str | bytes, encoding: str = "cdr", schema_encoding: str = "ros2msg") -> Channel:
        data = schema.encode() if isinstance(schema, str) else schema
        return Channel(1, "/topic", encoding, name, schema_encoding, data, {})

    return make


@pytest.fixture(scope="session")
def batch_of() -> Callable[[Channel, Sequence[bytes]], Batch]:
    """A batch of payloads, with bytes of somebody else before, between and behind them."""

    def make(channel: Channel, payloads: Sequence[bytes]) -> Batch:
        between = b"\xa5" * 31
        sizes = np.array([len(payload) for payload in payloads], np.int64)
        starts = np.cumsum(sizes + len(between)) - sizes
        data = b"".join(between + payload for payload in payloads) + between
        ns = np.arange(len(payloads), dtype=np.int64)
        return Batch(channel, data, starts, sizes, ns, ns, ns.astype(np.uint32))

    return make
