"""Teleop: a person drives a robot, or takes over from a policy and gives it back; every attempt is recorded whole."""

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from pipeline.errors import HardcaseError, RecordingError
from pipeline.frames import ACTION
from pipeline.protocols import Array, Call, Command, LiveRobot, Observation
from pipeline.recording.live import Closed, LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.recording.live_rows import Row, joint_targets
from pipeline.recording.ring import RingRecorder
from pipeline.robots.hand import Hand
from pipeline.robots.session import Controls, SceneOf, Session, Status, Who
from pipeline.simulation.recordings import episode_id
from schemas.episode import Outcome
from schemas.scene import SceneSpec

_ONE = np.arange(1)
_ENDS: tuple[Call, ...] = ("success", "failure", "unknown", "quit")


def teleop(robot: LiveRobot, controls: Controls, scene_of: SceneOf, session: Session) -> Iterator[Closed]:
    """Run attempts until all are done or the person quits; each is handed out as soon as its file is whole.

    A robot, device, policy or limit that fails ends its attempt, which is handed out with label 'unknown'; the error
    follows. Robot and device are connected by the caller, and given back by it.

    Args:
        robot: what is driven.
        controls: the person's device, and a policy that may be taken over from.
        scene_of: the start of each attempt.
        session: the rest.

    Raises:
        HardcaseError: see above, or the disk refuses; what was recorded before is kept.
    """
    for number in range(1, session.episodes + 1):
        if not _reset(robot, controls, session, number):
            return
        scene = scene_of(number - 1, robot.observe(_ONE))
        attempt = _Attempt(robot, controls, scene, session, number)
        closed, error = attempt.run()
        if closed is not None:
            yield closed
        yield from attempt.windows()
        if error is not None:
            raise error
        if attempt.last:
            return


def _reset(robot: LiveRobot, controls: Controls, session: Session, number: int) -> bool:
    """Let the person put everything back, until they say 'next'; False where they quit."""
    if not session.ask:
        return not session.stop()
    hand, ticks = Hand(robot, controls.driver, controls.limits), 0
    while not session.stop():
        observation, command = robot.observe(_ONE), controls.device.read()
        if "quit" in command.calls:
            return False
        if "next" in command.calls:
            return True
        hand.act(controls.driver.action(command, observation), observation)
        session.show(Status(number, ticks / robot.control_hz, "reset", observation, hand.note))
        ticks += 1
    return False


class _Attempt:
    """One attempt from its start to its end, on its way into a file."""

    def __init__(self, robot: LiveRobot, controls: Controls, scene: SceneSpec, session: Session, number: int) -> None:
        self._robot, self._controls, self._session, self._number = robot, controls, session, number
        self._hand = Hand(robot, controls.driver, controls.limits)
        self._who: Who = "operator" if controls.policy is None else "policy"
        self._phase, self._switch = "", False
        self.last = False
        if controls.shadow is not None:
            controls.shadow.begin()
        kind, actor = self._party()
        robot.begin(scene)
        make = RingRecorder if session.ring else LiveRecorder
        self._recorder = make(
            session.folder / f"{(name := episode_id('teleop', scene, session.operator, session.number))}.mcap",
            beginning(id=name, origin="teleop", scene=scene, control_hz=robot.control_hz, generation=0, kind=kind,
                      actor=actor, policy=controls.policy_id, consent=session.consent),
            attachments={**robot.attachments(), **_attached(session, scene)}, software=session.software,
            layout=robot.layout())
        self._give_to_policy()

    def windows(self) -> list[Closed]:
        """What a ring has kept at full rate."""
        return self._recorder.windows if isinstance(self._recorder, RingRecorder) else []

    def _give_to_policy(self) -> None:
        """Let the policy begin: what it planned before belongs to another course of events."""
        if self._controls.policy is not None:
            self._controls.policy.reset(1)
        if self._controls.alarm is not None:
            self._controls.alarm.reset()

    def _party(self) -> tuple[str, str]:
        """Kind and actor of a segment of whoever commands."""
        if self._who == "policy":
            return "autonomous", self._controls.policy_name
        return "demonstration" if self._controls.policy is None else "intervention", self._session.operator

    def run(self) -> tuple[Closed | None, HardcaseError | None]:
        """The finished recording, and what broke it off, if anything did."""
        outcome, failure, tick = None, None, 0
        with self._recorder as recorder:
            try:
                with self._controls.film(recorder) as take:
                    while outcome is None:
                        outcome = self._tick(tick, take)
                        tick += 1
            except HardcaseError as error:
                failure = error
                outcome = Outcome(label="unknown", judged_by="operator", reason=f"cut off: {error.what}")
            if recorder.frames == 0:
                with suppress(RecordingError):  # nothing was recorded: the empty file goes
                    recorder.close()
                return None, failure
            return recorder.close(outcome), failure

    def _tick(self, tick: int, take: Callable[[int, int], None]) -> Outcome | None:
        robot, recorder = self._robot, self._recorder
        stamp_ns = recorder.now()
        observation, command = robot.observe(_ONE), self._controls.device.read()
        take(tick, stamp_ns)
        self._switch_over(command, tick)
        if self._who == "operator" and isinstance(recorder, RingRecorder):
            recorder.keep(tick=tick)  # a person's part is whole, however long it takes
        self._watch(observation, tick)
        action = self._action(command, observation)
        recorder.joy(list(command.raw_axes), list(command.raw_buttons), tick=tick, stamp_ns=stamp_ns)
        for camera, picture in robot.pictures().items():
            recorder.image(camera, picture, tick=tick, stamp_ns=stamp_ns)
        if (phase := robot.phase()) != self._phase:
            recorder.phase(phase, tick=tick)
            self._phase = phase
        noted = self._hand.note
        if self._controls.shadow is not None:
            self._controls.shadow.offer(observation)
        self._hand.act(action, observation)
        if self._hand.note and self._hand.note != noted:
            recorder.event("limit", self._hand.note, level=30, tick=tick)
        if self._hand.note and (names := robot.signals.action) != ACTION:  # a robot that is commanded by its joints
            asked = joint_targets(names, action.astype(np.float64), stamp_ns)
            recorder.write("/joint_commands/asked", asked, tick=tick, stamp_ns=stamp_ns)
        recorder.tick(tick, self._row(tick), stamp_ns=stamp_ns)
        self._session.show(Status(self._number, (tick + 1) / robot.control_hz, self._who, observation, self._note()))
        return self._ended(command, tick)

    def _switch_over(self, command: Command, tick: int) -> None:
        """Let somebody else command from this tick on, if the person says so."""
        policy = self._controls.policy
        if policy is None:
            return
        held = command.intervening
        flips = held is not None and held != self._switch
        self._switch = bool(held)
        if flips:
            wanted: Who = "operator" if held else "policy"
        elif "take-over" in command.calls:
            wanted = "operator" if self._who == "policy" else "policy"
        else:
            return
        if wanted == self._who:
            return
        self._who = wanted
        if wanted == "policy":
            self._give_to_policy()
        kind, actor = self._party()
        self._recorder.segment(kind, actor, tick=tick)
        if isinstance(self._recorder, RingRecorder):
            self._recorder.trigger("take-over", f"{actor} takes over", tick=tick)

    def _watch(self, observation: Observation, tick: int) -> None:
        """Notice where the policy fails."""
        alarm = self._controls.alarm
        if alarm is not None and self._who == "policy" and alarm.see(observation) and alarm.raised is not None:
            text = f"{alarm.raised[0]}, {alarm.raised[1]}"
            if isinstance(self._recorder, RingRecorder):
                self._recorder.trigger(alarm.raised[0], text, tick=tick)
            else:
                self._recorder.event("trigger", text, level=30, tick=tick)

    def _note(self) -> str:
        """What a person should know now."""
        alarm = self._controls.alarm
        if self._who == "policy" and alarm is not None and alarm.raised is not None:
            return f"FAILS: {alarm.raised[0]}"
        return self._hand.note

    def _action(self, command: Command, observation: Observation) -> Array:
        if self._who == "policy" and self._controls.policy is not None:
            return self._controls.policy.act(observation, _ONE)[0]
        return self._controls.driver.action(command, observation)

    def _row(self, tick: int) -> Row | Array:
        """The robot's row; what the policy remembers is part of what a restore needs."""
        row, policy, shadow = self._robot.row(), self._controls.policy, self._controls.shadow
        if shadow is not None and isinstance(row, Row):
            row = shadow.beside(row, self._recorder, tick)
        if policy is None or not isinstance(row, Row) or not len(row.sim_state):
            return row
        return replace(row, controller=np.concatenate([row.controller, policy.memory(_ONE)[0]]))

    def _ended(self, command: Command, tick: int) -> Outcome | None:
        """How the attempt has ended; None while it goes on."""
        self.last = "quit" in command.calls or self._session.stop()
        for label in ("success", "failure"):
            if label in command.calls:
                return Outcome(label=label, judged_by="operator")
        if not self._session.by_key and self._robot.succeeded():
            return Outcome(label="success", judged_by=self._robot.judge)
        alarm = self._controls.alarm
        if self._session.stop_on_trigger and self._who == "policy" and alarm is not None and alarm.raised is not None:
            return Outcome(label="failure", judged_by="sensors", trigger=alarm.raised[0], family=alarm.raised[1],
                           tick=tick)
        if self._session.stop() or self._recorder.failed:  # what the disk refused, `close` says
            return Outcome(label="unknown", judged_by="operator", reason="cut off: interrupted")
        if any(call in command.calls for call in _ENDS):
            return Outcome(label="unknown", judged_by="operator", reason="the operator gave no label")
        if (tick + 1) / self._robot.control_hz >= self._session.max_s:
            return Outcome(label="unknown", judged_by="operator", reason=f"time is up after {self._session.max_s:g} s")
        return None


def _attached(session: Session, scene: SceneSpec) -> dict[str, bytes]:
    return {"config.json": json.dumps(dict(session.config), sort_keys=True).encode(),
            "randomization.json": json.dumps([d.model_dump() for d in scene.draws]).encode()}
