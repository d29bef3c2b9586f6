"""Encoding a video leaves the machine to others."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.lerobot_view import video


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has these policies")
def test_no_thread_is_real_time_while_a_video_is_encoded_or_after(tmp_path: Path) -> None:
    def pictures():
        for k in range(4):
            seen.append({os.sched_getscheduler(int(t.name)) for t in Path("/proc/self/task").iterdir()})
            yield np.full((64, 64, 3), 40 * k, np.uint8)

    seen: list[set[int]] = []
    video.encode(pictures(), tmp_path / "a.mp4", fps=20, where="test")

    assert len(seen) == 4
    assert set.union(*seen[1:]) == {os.SCHED_OTHER}
    assert {os.sched_getscheduler(int(t.name)) for t in Path("/proc/self/task").iterdir()} == {os.SCHED_OTHER}
