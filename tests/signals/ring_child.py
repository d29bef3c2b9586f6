"""A robot of 100 Hz that is recorded in a ring until somebody kills it.

Usage: ring_child.py OUT.mcap TICKFILE TRIGGER. TICKFILE holds the number of the tick that was recorded last, 8 bytes;
at tick TRIGGER something happens.
"""

import mmap
import struct
import sys
import time
from pathlib import Path

import numpy as np

from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row
from pipeline.recording.ring import RingRecorder
from pipeline.recording.ring_lap import Ring
from schemas.scene import SceneSpec

HZ = 100.0


def main() -> None:
    out, ticks, trigger = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    scene = SceneSpec(family="study", seed=7, robot="arm", scene="table", task="pick-place", stratum="common",
                      object_xy_m=(0.3, 0.1), object_yaw_rad=0.2, object_half_m=0.02, target_xy_m=(0.3, -0.1))
    known = {"id": "00112233445566aa", "origin": "deployed", "scene": scene, "control_hz": HZ, "generation": 0}
    with ticks.open("r+b") as stream:
        shared = mmap.mmap(stream.fileno(), 8)
    recorder = RingRecorder(out, beginning(**known, kind="autonomous", actor="policy"), attachments={},
                            ring=Ring(before_s=1.0, after_s=60.0, every=10))
    began = time.monotonic()
    for tick in range(100_000):
        if tick == trigger:
            recorder.trigger("stall", "stall", tick=tick)
        recorder.tick(tick, Row(np.full(16, float(tick)), np.zeros(7), np.zeros(5), np.zeros(7)))
        struct.pack_into("<q", shared, 0, tick)
        time.sleep(max(0.0, began + (tick + 1) / HZ - time.monotonic()))


if __name__ == "__main__":
    main()
