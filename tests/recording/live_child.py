"""A simulated robot that is recorded at 50 Hz in real time, with two cameras, until somebody kills it.

Usage: live_child.py OUT.mcap TICKFILE SEED. TICKFILE holds the number of the tick that runs, 8 bytes.
"""

import mmap
import struct
import sys
from pathlib import Path

import numpy as np

from pipeline.errors import SimulationError
from pipeline.protocols import Picture
from pipeline.recording.filming import Filming
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.robots.simulated import SimulatedRobot
from pipeline.simulation.bodies import load_body
from pipeline.simulation.expert import Expert
from pipeline.simulation.live_cameras import SceneCameras
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.world import World
from stages.record import record

HZ = 50.0


class Painted(SceneCameras):
    """Where nothing can render: coloured noise, as large as a rendered picture."""

    def open(self) -> None:
        """Nothing to open."""

    def read(self, timeout_s: float) -> list[Picture]:
        """One picture a camera."""
        with self._new:
            if not self._waiting:
                self._new.wait(timeout_s)
            waiting = [self._waiting.popleft()] if self._waiting else []
        noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
        return [Picture(name, noise, stamp_ns, tick) for _, tick, stamp_ns in waiting for name in self.names]


def main() -> None:
    out, ticks, seed = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    scene = sample_scene("pick-place", "study", scene_seed("study", seed), "common")
    world = World(compose(load_body("arm"), "table"), [scene], from_draws([()]), threads=1, control_hz=HZ)
    robot = SimulatedRobot(world, "arm", judged=True)
    known = {"id": "00112233445566aa", "origin": "scripted", "scene": scene, "control_hz": HZ, "generation": 0}
    with ticks.open("r+b") as stream:
        shared = mmap.mmap(stream.fileno(), 8)
    recorder = LiveRecorder(out, beginning(**known, kind="autonomous", actor="expert"),
                            attachments=robot.attachments())
    view = (world.batch.get_model(0), ("front", "top"))
    try:
        cameras = SceneCameras(*view, width=160, height=120)
        filming = Filming(recorder, cameras)
    except SimulationError:
        cameras = Painted(*view)
        filming = Filming(recorder, cameras)

    def show(tick: int, stamp_ns: int) -> None:
        struct.pack_into("<q", shared, 0, tick)
        cameras.show(world.save(np.arange(1))[0][0], tick, stamp_ns)

    robot.begin(scene)
    record(robot, Expert(), recorder, seconds=60, show=show)
    filming.stop()
    recorder.close()


if __name__ == "__main__":
    main()
