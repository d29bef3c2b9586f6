"""Faults of what was measured and commanded: each changes numbers of a recording and nothing else of it."""

from collections.abc import Callable

import numpy as np

from pipeline.check.contract import urdf_limits
from pipeline.selftest.log import Log, Rows

type Rng = np.random.Generator
type Part = tuple[str, str]
"""Topic and field."""

STATES, COMMANDS = "/joint_states", "/joint_commands"
MEASURED: Part = (STATES, "position")
COMMANDED: Part = (COMMANDS, "position")
ACTION: Part = ("/command/ee", "data")
TOOL: Part = ("/ee/measured", "data")
LAG = 8
"""Frames; 0.4 s at 20 Hz, about what a person reacts in."""
MOTION = 4
"""Values of an action that move the tool; the fifth is the finger opening asked for [m]."""
ARM = 6
"""Joints that turn; the seventh value is the finger opening [m]."""


def frozen_joint(log: Log, rng: Rng) -> None:
    """One joint's encoder repeats its last reading for 1.2 to 1.6 s while the joint is driven by 0.1 rad and more."""
    rows, commands, stamps = log.numbers(*MEASURED), log.numbers(*COMMANDED), [m.log_time for m in log.of(STATES)]
    ticks = round(rng.uniform(1.2, 1.6) / (np.median(np.diff(stamps)) / 1e9))
    moved = np.array([np.ptp(commands[k:k + ticks, :ARM], axis=0) for k in range(2, len(rows) - ticks)])
    start, joint = rng.choice(np.argwhere(moved > 0.1)) if (moved > 0.1).any() else \
        np.unravel_index(int(moved.argmax()), moved.shape)
    inside = slice(int(start) + 2, int(start) + 2 + ticks)
    rows[inside, joint] = rows[inside, joint][0]
    log.put(*MEASURED, rows)
    speeds = log.numbers(STATES, "velocity")
    if speeds.size:
        speeds[inside, joint] = 0.0
        log.put(STATES, "velocity", speeds)


def late_actions(log: Log, rng: Rng) -> None:
    """Every action is recorded 8 frames after the state that it answered, as by a queue between policy and recorder."""
    for part in (COMMANDED, ACTION):
        log.put(*part, _delayed(log.numbers(*part)))


def turned_actions(log: Log, rng: Rng) -> None:
    """Every motion is recorded the other way round, as with a device that was plugged in upside down."""
    rows = log.numbers(*ACTION)
    rows[:, :MOTION] *= -1
    log.put(*ACTION, rows)


def shuffled_actions(log: Log, rng: Rng) -> None:
    """The actions of the attempt are recorded in random order, as by a merge by the wrong key."""
    rows = log.numbers(*ACTION)
    log.put(*ACTION, rows[rng.permutation(len(rows))])


def late_states(log: Log, rng: Rng) -> None:
    """Every measurement is 8 frames old when it is recorded, as over a buffered serial line."""
    for part in (MEASURED, TOOL):
        log.put(*part, _delayed(log.numbers(*part)))


def _delayed(rows: Rows) -> Rows:
    return np.concatenate([np.repeat(rows[:1], LAG, axis=0), rows[:-LAG]])


def coarse(log: Log) -> None:
    """No fault: the joints are read by encoders of 12 bits a turn, the finger to 0.1 mm, as on arms that people buy."""
    rows, step = log.numbers(*MEASURED), 2 * np.pi / 4096
    rows[:, :ARM] = np.round(rows[:, :ARM] / step) * step
    rows[:, ARM] = np.round(rows[:, ARM], 4)
    log.put(*MEASURED, rows)


def nan_at(part: Part) -> Callable[[Log, Rng], None]:
    """One value of a field is NaN in one frame."""
    def plant(log: Log, rng: Rng) -> None:
        rows = log.numbers(*part)
        rows[rng.integers(len(rows)), rng.integers(rows.shape[1])] = np.nan
        log.put(*part, rows)
    return plant


def degrees_in(part: Part) -> Callable[[Log, Rng], None]:
    """The joints of a field are in degrees, the fingers still in metres."""
    def plant(log: Log, rng: Rng) -> None:
        rows = log.numbers(*part)
        rows[:, :ARM] = np.degrees(rows[:, :ARM])
        log.put(*part, rows)
    return plant


def finger_in_millimetres(log: Log, rng: Rng) -> None:
    """The measured finger opening is in millimetres, its command in metres."""
    rows = log.numbers(*MEASURED)
    rows[:, ARM] *= 1000
    log.put(*MEASURED, rows)


def tool_in_millimetres(log: Log, rng: Rng) -> None:
    """The measured position of the tool is in millimetres."""
    rows = log.numbers(*TOOL)
    rows[:, :3] *= 1000
    log.put(*TOOL, rows)


def spike(log: Log, rng: Rng) -> None:
    """One reading of one joint is off by 0.15 to 0.3 rad, as by a bit that flipped on the bus."""
    rows = log.numbers(*MEASURED)
    rows[rng.integers(5, len(rows) - 5), rng.integers(ARM)] += rng.choice([-1, 1]) * rng.uniform(0.15, 0.3)
    log.put(*MEASURED, rows)


def beyond_limits(log: Log, rng: Rng) -> None:
    """The zero of joint 2 or 3 slips in mid-motion so far that readings pass its limit by 0.15 to 0.3 rad."""
    rows, limits = log.numbers(*MEASURED), _limits(log)
    joint, half = int(rng.integers(1, 3)), len(rows) // 2
    low, high = limits[log.names(STATES)[joint]]
    later = rows[half:, joint]
    up, down = high - later.max(), later.min() - low
    rows[half:, joint] += up + rng.uniform(0.15, 0.3) if up < down else -down - rng.uniform(0.15, 0.3)
    log.put(*MEASURED, rows)


def _limits(log: Log) -> dict[str, tuple[float, float]]:
    found = urdf_limits(log.attachment("robot.urdf"))
    return {name: (limit.low, limit.high) for name, limit in found.items()
            if limit.low is not None and limit.high is not None}
