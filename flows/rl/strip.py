"""A film strip of a trained policy at work: pictures of one attempt side by side, each with its time."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from flows.rl.training import opened
from pipeline.errors import ConfigError
from pipeline.files import atomic
from pipeline.locomotion.evaluation import evaluation_seed
from pipeline.locomotion.gym_env import LeggedEnv
from pipeline.locomotion.tasks import LeggedTask

PICTURES = 8
WALKS_FROM_S, APART_S = 4.0, 0.2
"""Begin of the strip in tasks with a gait (others: 0), and the time between pictures of the others."""
KINDS = (".webp", ".png")
ROWS, MIDDLE = slice(30, 240), slice(70, 250)
"""Rows and columns of a picture that show the robot."""


def write_strip(policy: Path, to: Path, *, seed: int = 0, stratum: str | None = None,
                speed: float | None = None) -> str:
    """Draw the first of the starts that `evaluate` plays under this seed, and say what is drawn.

    In a task with a gait's clock it is one stride, from 4 s on; in others the first 1.4 s, where a fall is caught.
    A fall ends the strip.

    Args:
        policy: an ONNX file, or the folder of a training.
        to: .webp or .png.
        seed, stratum, speed: as in `evaluated`.

    Raises:
        HardcaseError: no such policy, nothing here renders, or a name that ends otherwise.
    """
    if to.suffix not in KINDS:
        raise ConfigError(f"cannot draw a picture of kind {to.suffix or 'none'}", where=to,
                          mend=f"give a name that ends in {' or '.join(KINDS)}")
    runner, body, task = opened(policy, speed)
    kind = stratum or runner.facts.get("stratum") or next(iter(task.starts))
    env = LeggedEnv(body, task, kind, render_mode="rgb_array")
    try:
        pictures, times, fell = _played(env, runner, task, evaluation_seed(seed, 0))
    finally:
        env.close()
    sheet = Image.fromarray(np.concatenate([picture[ROWS, MIDDLE] for picture in pictures], axis=1))
    draw, width = ImageDraw.Draw(sheet), MIDDLE.stop - MIDDLE.start
    for k, time_s in enumerate(times):
        draw.text((k * width + 8, 6), f"{time_s:.2f} s", fill=(255, 255, 255))
    with atomic(to) as stream:
        sheet.save(stream, to.suffix[1:], quality=80)
    return f"{len(times)} pictures from {times[0]:.2f} s to {times[-1]:.2f} s{', where it fell' if fell else ''}: {to}"


def _played(env: LeggedEnv, runner: Any, task: LeggedTask,
            start: int) -> tuple[list[NDArray[np.uint8]], list[float], bool]:
    """Pictures, their times [s], and whether the attempt ended in a fall."""
    apart = task.stride_s / PICTURES or APART_S
    begin = min(WALKS_FROM_S, max(0.0, task.seconds - PICTURES * apart)) if task.stride_s else 0.0
    due = [round((begin + k * apart) * task.control_hz) for k in range(PICTURES)]
    pictures: list[NDArray[np.uint8]] = []
    times: list[float] = []
    seen, _ = env.reset(options={"start": start})
    for tick in range(min(due[-1], task.ticks) + 1):
        fallen = False
        if tick:
            seen, _, fallen, _, _ = env.step(runner(seen[None])[0].astype(np.float32))
        if tick in due or fallen:
            picture = env.render()
            assert picture is not None
            pictures.append(picture)
            times.append(tick / task.control_hz)
        if fallen:
            return pictures, times, True
    return pictures, times, False
