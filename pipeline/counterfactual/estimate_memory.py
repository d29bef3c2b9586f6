"""Memory: what the lower controller remembers at a tick, told from the commands that were logged."""

import numpy as np

from pipeline.counterfactual.estimate_log import ASKED, POSE, SensedLog
from pipeline.protocols import Array
from pipeline.simulation.physics import MAX_DELAY, Physics


def played(log: SensedLog, physics: Physics, rng: np.random.Generator, stop: int) -> Array:
    """What the motors had been asked for after delay and play, before each tick up to `stop`, under each hypothesis.

    The controller is ours, so its memory follows from what was logged; only which commands came a tick late has to
    be drawn.

    Args:
        log: of the attempt.
        physics: p hypotheses: delay, jitter and backlash are read.
        rng: draws which commands came late.
        stop: last tick.

    Returns:
        Rows as World keeps them, shape (stop + 1, p, 7).
    """
    sent, p = log.sent, len(physics.delay)
    half, out = physics.backlash[:, None] / 2, np.empty((stop + 1, p, 7))
    out[0] = sent[0]
    late = rng.random((stop, p)) < physics.jitter
    row = MAX_DELAY + 1 + np.arange(stop)[:, None] - np.minimum(physics.delay.astype(int) + late, MAX_DELAY)
    for tick in range(stop):
        wanted = sent[row[tick]]
        wanted[:, :6] = np.clip(out[tick, :, :6], wanted[:, :6] - half, wanted[:, :6] + half)
        out[tick + 1] = wanted
    return out


def memory(log: SensedLog, tick: int, play: Array, held: int) -> Array:
    """Rows of World's controller before the action of a tick, shape (p, CONTROLLER_WIDTH).

    Args:
        log: of the attempt.
        tick: where the controller is to go on.
        play: one row a hypothesis, shape (p, 7).
        held: ticks for which the task has counted as done.
    """
    sent = log.sent
    line = sent[tick:tick + MAX_DELAY + 1][::-1]
    same = np.concatenate([log.state[tick, POSE], [log.state[tick, ASKED]], line[0, :6], line.ravel()])
    return np.column_stack([np.tile(same, (len(play), 1)), play,
                            np.tile(np.array([tick, held, 0.0]), (len(play), 1))])
