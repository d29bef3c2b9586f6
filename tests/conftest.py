"""What every test shares."""

from collections.abc import Iterator

import pytest

from pipeline.lerobot_view.scheduling import fair


@pytest.fixture(autouse=True)
def _no_test_takes_the_machine() -> Iterator[None]:
    """lerobot's own encoder, run by root, leaves the process real-time, and its children starve all others."""
    with fair():
        yield
