"""Faults of what the rows of a dataset say was measured and commanded: as in pipeline.selftest.values."""

import numpy as np

from pipeline.frames import STATE
from pipeline.selftest.dataset import Dataset
from pipeline.selftest.rows import ACTION, ARM, LAG, TARGET, Rng
from pipeline.selftest.rows import STATE as MEASURED

FINGER = STATE.index("gripper")
TOOL = slice(STATE.index("ee_x"), STATE.index("ee_z") + 1)
OWN = slice(0, STATE.index("cmd_x"))
"""What was measured, before the values that say what was commanded."""
HOLD_S = 1.4


def frozen_joint(data: Dataset, rng: Rng) -> None:
    """One joint's encoder repeats its last reading for 1.4 s while the joint is driven by 0.1 rad and more."""
    ticks = round(HOLD_S * int(data.info["fps"]))
    rows, targets = data.rows[MEASURED].copy(), data.rows[TARGET]
    places = [(k, joint) for part in data.parts() for k in range(part.start + 2, part.stop - ticks)
              for joint in np.flatnonzero(np.ptp(targets[k:k + ticks, :ARM], axis=0) > 0.1).tolist()]
    start, joint = places[int(rng.integers(len(places)))]
    rows[start:start + ticks, joint] = rows[start, joint]
    data.rows[MEASURED] = rows
    data.measure()


def late_states(data: Dataset, rng: Rng) -> None:
    """Every measurement is 8 rows old."""
    rows = data.rows[MEASURED].copy()
    for part in data.parts():
        rows[part, OWN] = np.concatenate([np.repeat(rows[part, OWN][:1], LAG, axis=0), rows[part, OWN][:-LAG]])
    data.rows[MEASURED] = rows
    data.measure()


def nan_action(data: Dataset, rng: Rng) -> None:
    """One value of one action is NaN."""
    rows = data.rows[ACTION].copy()
    rows[rng.integers(len(rows)), rng.integers(rows.shape[1])] = np.nan
    data.rows[ACTION] = rows


def degrees_commanded(data: Dataset, rng: Rng) -> None:
    """The commanded joints are in degrees."""
    rows = data.rows[TARGET].copy()
    rows[:, :ARM] = np.degrees(rows[:, :ARM])
    data.rows[TARGET] = rows
    data.measure()


def finger_in_millimetres(data: Dataset, rng: Rng) -> None:
    """The measured finger opening is in millimetres, its command in metres."""
    _scale(data, slice(FINGER, FINGER + 1))


def tool_in_millimetres(data: Dataset, rng: Rng) -> None:
    """The measured position of the tool is in millimetres, its command in metres."""
    _scale(data, TOOL)


def _scale(data: Dataset, columns: slice) -> None:
    rows = data.rows[MEASURED].copy()
    rows[:, columns] *= 1000
    data.rows[MEASURED] = rows
    data.measure()


def spike(data: Dataset, rng: Rng) -> None:
    """One reading of one joint is off by 0.15 to 0.3 rad."""
    rows, parts = data.rows[MEASURED].copy(), data.parts()
    part = parts[int(rng.integers(len(parts)))]
    rows[rng.integers(part.start + 5, part.stop - 5), rng.integers(ARM)] += rng.choice([-1, 1]) * rng.uniform(0.15, 0.3)
    data.rows[MEASURED] = rows
    data.measure()


def beyond_limits(data: Dataset, rng: Rng) -> None:
    """The zero of joint 2 or 3 slips in the middle of an episode by 2 rad, beyond what the joint can do."""
    rows, parts = data.rows[MEASURED].copy(), data.parts()
    part, joint = parts[int(rng.integers(len(parts)))], int(rng.integers(1, 3))
    later = slice(part.start + (part.stop - part.start) // 2, part.stop)
    rows[later, joint] += 2.0 * np.sign(rows[later, joint].mean())
    data.rows[MEASURED] = rows
    data.measure()
