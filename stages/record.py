"""Record: a policy works a robot in real time, and everything is written down while it happens."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np

from pipeline.protocols import Array, LiveRobot, Policy
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row
from pipeline.recording.ring import RingRecorder
from pipeline.shadow.live import LiveShadow
from pipeline.signals.live import LiveWatch
from pipeline.signals.tick import plan_of
from schemas.episode import Outcome

_ONE = np.arange(1)


def record(robot: LiveRobot, policy: Policy, recorder: LiveRecorder | RingRecorder, *, seconds: float,
           until_success: bool = False,
           show: Callable[[int, int], None] = lambda tick, stamp_ns: None,
           stop: Callable[[], bool] = lambda: False, shadow: LiveShadow | None = None,
           watch: LiveWatch | None = None) -> Outcome:
    """Let a policy act until the time is over, and say how it ended; the caller closes the recording.

    Args:
        robot: connected and put at its start; lets the time of each tick pass.
        policy: acts on what the robot perceives.
        recorder: takes every tick; a ring keeps all of them around a trigger.
        seconds: length of the attempt on the robot's clock [s].
        until_success: end with the task, if that comes first.
        show: called with (tick, time [ns]) when the robot has perceived: cameras take their pictures.
        stop: whether somebody wants it to end now.
        shadow: candidates that are shown the same, and are heard when the tick is over.
        watch: computes the signals of risk, and says what is noticed.
    """
    policy.reset(1)
    if shadow is not None:
        shadow.begin()
    if watch is not None:
        watch.begin()
    reached, last = False, ""
    for tick in count():
        stamp_ns = recorder.now()
        observation = robot.observe(_ONE)
        show(tick, stamp_ns)
        if (phase := robot.phase()) != last:
            recorder.phase(phase, tick=tick)
            last = phase
        plan = plan_of(policy, _ONE) if watch is not None else None
        action = policy.act(observation, _ONE)
        if shadow is not None:
            shadow.offer(observation)
        robot.act(action, _ONE)
        row = _with_memory(robot.row(), policy)
        if shadow is not None and isinstance(row, Row):
            row = shadow.beside(row, recorder, tick)
        if watch is not None and isinstance(row, Row):
            signals, noticed = watch.tick(observation, action, shadow.answers if shadow else {}, plan)
            row = replace(row, signals=signals)
            if noticed is not None:
                _tell(recorder, noticed, tick)
        recorder.tick(tick, row, stamp_ns=stamp_ns)
        reached = reached or robot.succeeded()
        if stop() or recorder.failed:  # what the disk refused, `close` says
            return Outcome(label="unknown", judged_by=robot.judge, reason="cut off: interrupted")
        if (reached and until_success) or (tick + 1) / robot.control_hz >= seconds:
            break
    return Outcome(label="success" if reached else "failure", judged_by=robot.judge)


def _tell(recorder: LiveRecorder | RingRecorder, noticed: str, tick: int) -> None:
    if isinstance(recorder, RingRecorder):
        recorder.trigger(noticed, noticed, tick=tick)
    else:
        recorder.event("trigger", noticed, level=30, tick=tick)


def _with_memory(row: Row | Array, policy: Policy) -> Row | Array:
    """What the policy remembers is part of what a restore needs."""
    if not isinstance(row, Row) or not len(row.sim_state):
        return row
    return replace(row, controller=np.concatenate([row.controller, policy.memory(_ONE)[0]]))
