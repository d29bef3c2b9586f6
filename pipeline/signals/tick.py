"""Signals: what is computed at every tick from the champion's plan and from what the candidates would have done.

The deploy loop, a live recording and a study all call `Signals.tick`; nothing in here can act.
"""

import warnings
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline.disagreement import ACTION_SCALE, disagreement
from pipeline.frames import ACTION
from pipeline.policies.ensembling import DECAY, weights
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.signals.neighbours import Neighbours
from pipeline.signals.warning import WEIGHTS, Running, warning

GRIP = ACTION.index("gripper")
NAMES = ("distance", "revision", "apart", "spread", "flips", "warning")
"""Every signal, in the order in which they are recorded; the disagreement with each candidate stands beside them."""


class Signals:
    """The signals of n attempts, tick by tick.

    distance: to the training data, see neighbours.py; absent where no index is given.
    revision: how far the champion's action departs from what its own earlier chunks had planned for this tick, in
        scales of the action; NaN at the first tick; absent where the champion plans no chunks.
    apart: disagreement with the candidate that is nearest: all that answered are at least so far from the champion.
    spread: standard deviation over champion and candidates, mean over the action's values, in scales.
    flips: share of the candidates that answered and mean the gripper to go the other way than the champion does.
    warning: chance of failure as far as the running means of distance and revision tell, see warning.py.

    apart, spread and flips are absent where no candidate rides, and NaN where none has answered.

    Args:
        n: attempts.
        neighbours: the champion's training data.
    """

    def __init__(self, n: int, neighbours: Neighbours | None = None) -> None:
        self._neighbours, self._running = neighbours, Running(n)

    def tick(self, observation: Observation, action: Array, answers: Mapping[str, Array], ids: Ids,
             plan: Array | None) -> dict[str, Array]:
        """Signal -> its value for each attempt of the tick, shape (len(ids),).

        Args:
            observation: what the champion saw.
            action: what it does, shape (len(ids), 5).
            answers: candidate -> what it would have done, shape (len(ids), 5), NaN rows where it was silent.
            ids: the attempts.
            plan: what the champion had planned to do now, see `plan_of`.
        """
        found: dict[str, Array] = {}
        if self._neighbours is not None:
            found["distance"] = self._neighbours.distance(observation)
        if plan is not None:
            found["revision"] = disagreement(action, plan)
        if answers:
            others = np.stack([*answers.values()])
            found |= {"apart": apart(action, others), "spread": spread(action, others), "flips": flips(action, others)}
        if WEIGHTS.keys() <= found.keys():
            found["warning"] = warning(self._running.tick({name: found[name] for name in WEIGHTS}, ids))
        return found


def plan_of(champion: Policy, ids: Ids) -> Array | None:
    """What a policy has planned for the tick that comes, asked before it acts; None where it plans no chunks."""
    return planned(champion.memory(ids)) if isinstance(champion, OnnxPolicy) else None


def planned(memory: Array, decay: float = DECAY) -> Array:
    """The action (n, 5) that the chunks of earlier ticks had planned for now; NaN at an attempt's first tick.

    Args:
        memory: rows of pipeline.policies.ensembling.Ensembler.memory: sums for the coming ticks, and a count.
        decay: the policy's.
    """
    chunk = (memory.shape[1] - 1) // len(ACTION) + 1
    total = np.cumsum(weights(chunk, decay))
    seen = memory[:, -1].astype(np.intp)
    weight = total[np.minimum(seen + 1, chunk) - 1] - total[0]  # the newest prediction, of weight total[0], is to come
    return np.where(seen[:, None] > 0, memory[:, :len(ACTION)] / np.maximum(weight, 1e-300)[:, None], np.nan)


def apart(action: Array, others: Array) -> Array:
    """Disagreement with the nearest candidate that answered, in scales, shape (n,); NaN where none did.

    Args:
        action: the champion's, shape (n, 5).
        others: the candidates', shape (candidates, n, 5).
    """
    each = np.stack([disagreement(other, action) for other in others])
    nearest = np.where(np.isfinite(each), each, np.inf).min(axis=0)
    return np.where(np.isfinite(nearest), nearest, np.nan)


def spread(action: Array, others: Array) -> Array:
    """Standard deviation over champion and candidates that answered, in scales, shape (n,); NaN where none did.

    Args: see `apart`.
    """
    answered = _answered(others)
    everyone = np.concatenate([action[None], np.where(answered[:, :, None], others, np.nan)]) / ACTION_SCALE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a champion's NaN is somebody else's error
        found = np.nanstd(everyone, axis=0).mean(axis=1)
    return np.where(answered.any(axis=0), found, np.nan)


def flips(action: Array, others: Array) -> Array:
    """Share of the candidates that answered whose gripper would go the other way, shape (n,); NaN where none did.

    Half of the full opening divides open from closed.

    Args: see `apart`.
    """
    half_m = ACTION_SCALE[GRIP] / 2
    answered = _answered(others)
    opposite = answered & ((others[:, :, GRIP] > half_m) != (action[:, GRIP] > half_m))
    count = answered.sum(axis=0)
    return np.where(count > 0, opposite.sum(axis=0) / np.maximum(count, 1), np.nan)


def _answered(others: Array) -> NDArray[np.bool_]:
    """Which candidates answered for which attempts, shape (candidates, n)."""
    return np.isfinite(others.sum(axis=2))
