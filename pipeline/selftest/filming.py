"""Recordings with cameras, made by the live recorder on a clock as uneven as that of a busy computer."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.check.projection import scene_poses
from pipeline.recording.dialect import EPOCH_NS
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row
from pipeline.trace import Trace
from schemas.episode import Episode

type Pictures = Mapping[str, NDArray[np.uint8]]

CAMERAS = ("front", "top")
WIDTH, HEIGHT = 96, 72
LATE_NS, HICCUP_NS, HICCUP_SHARE = 800_000, 18_000_000, 0.03
"""How late a tick is recorded: 0.8 ms as a rule, 18 ms more in three of a hundred."""
TAKEN_NS, DELIVERED_NS = (2_000_000, 9_000_000), (5_000_000, 20_000_000)
"""When a picture is exposed after its tick, and when it arrives after that."""
NOISE_GREY = 1.5
"""Standard deviation of a sensor's noise [grey values of 255]."""


def film(path: Path, episode: Episode, trace: Trace, pictures: Pictures, attachments: Mapping[str, bytes],
         rng: np.random.Generator) -> Episode:
    """Record an attempt live, tick by tick, with what its cameras saw.

    Args:
        path: the file to write.
        episode: what was attempted.
        trace: what happened.
        pictures: camera -> RGB, shape (ticks, height, width, 3).
        attachments: files that the recording carries.
        rng: for lateness and noise.

    Returns:
        The episode with the file's hash.
    """
    clock = _Clock()
    recorder = LiveRecorder(path, episode.model_copy(update={"blob": None}), clock=clock, attachments=attachments,
                            reserve_bytes=0)
    period_ns = 1e9 / trace.hz
    for tick in range(len(trace)):
        stamp_ns = EPOCH_NS + round(tick * period_ns)
        hiccup = HICCUP_NS if rng.random() < HICCUP_SHARE else 0
        clock.set(stamp_ns + int(rng.exponential(LATE_NS)) + hiccup)
        recorder.tick(tick, _row(trace, tick), stamp_ns=stamp_ns)
        for camera, frames in pictures.items():
            taken_ns = stamp_ns + int(rng.integers(*TAKEN_NS))
            clock.set(taken_ns + int(rng.integers(*DELIVERED_NS)))
            recorder.image(camera, _noisy(frames[tick], rng), tick=tick, stamp_ns=taken_ns)
    return recorder.close(episode.outcome, episode.segments).episode


class _Clock:
    """Log time as the recorder is told it; it never goes back."""

    def __init__(self) -> None:
        self._now = EPOCH_NS

    def set(self, now_ns: int) -> None:
        self._now = max(self._now + 1, now_ns)

    def __call__(self) -> int:
        return self._now


def _row(trace: Trace, tick: int) -> Row:
    return Row(trace.state[tick], trace.environment[tick], trace.action[tick], trace.joint_action[tick],
               trace.joint_velocity[tick], trace.joint_effort[tick], links=trace.links,
               link_poses=trace.link_poses[tick])


def _noisy(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """No sensor gives the same picture twice."""
    noise = rng.normal(0.0, NOISE_GREY, (*picture.shape[:2], 1))
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def drawn(trace: Trace, scene: bytes) -> dict[str, NDArray[np.uint8]]:
    """Pictures for a machine on which nothing renders: the arm as a line of blocks, where each camera would see it.

    Args:
        trace: the attempt.
        scene: scene.xml, for the poses of its cameras.
    """
    poses = scene_poses(scene)
    found: dict[str, NDArray[np.uint8]] = {}
    for n, name in enumerate(CAMERAS):
        ground = np.kron(np.random.default_rng(n).integers(60, 200, (6, 8)), np.ones((HEIGHT // 6, WIDTH // 8)))
        frames = np.repeat(ground.astype(np.uint8)[None, :, :, None], len(trace), axis=0).repeat(3, axis=3)
        for share in np.linspace(0, 1, 12):
            arm = (1 - share) * np.array([0.0, 0.0, 0.4]) + share * trace.state[:, 7:10]
            for picture, (right, down) in zip(frames, poses[name].seen(arm), strict=True):
                x, y = int(WIDTH * (0.5 + 0.97 * right)), int(HEIGHT * (0.5 + 1.3 * down))
                picture[max(0, y - 4):max(0, y + 4), max(0, x - 4):max(0, x + 4)] = (250, 40, 20)
        found[name] = frames
    return found
