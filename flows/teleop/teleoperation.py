"""`hardcase teleop`: a session of a person with a robot, from the command line to episodes in the store."""

import re
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import cast

from flows.run import facts
from flows.teleop.devices import Driven, TeleopOrder, open_device, open_policy, open_robot
from flows.teleop.display import StatusLine, print_attempts
from flows.teleop.shadowing import print_states, shadowed
from flows.teleop.store import FOLDER, adopt, keep
from pipeline.consent import Consents
from pipeline.errors import ConfigError, StoreError
from pipeline.files import short_id
from pipeline.protocols import Teleoperator
from pipeline.recording.live import Closed
from pipeline.recording.metadata import record_strings
from pipeline.robots.gamepad import HELP as BUTTONS
from pipeline.robots.judging import Alarm
from pipeline.robots.keyboard import HELP as KEYS
from pipeline.robots.keyboard import Keyboard
from pipeline.robots.session import Controls, Session
from pipeline.robots.with_keys import WithKeys
from pipeline.shadow.live import Arm, LiveShadow
from pipeline.simulation.tasks import load_task
from pipeline.store import Lease, RunInfo, Store
from schemas.consent import NO_CONSENT, Consent
from stages.teleop import teleop

TELEOP = "teleop"
"""Stands in the run's `control`, so that no loop takes a session for a run of its own."""


class Stop:
    """Whether somebody asked the session to end: by Ctrl-C, SIGTERM, or a connection that broke (SIGHUP)."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        """Whether it was asked for."""
        return self.asked

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:  # the second time somebody means it: what was written stays for recover
            raise KeyboardInterrupt
        self.asked = True

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take the signals while the body runs."""
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = {number: signal.signal(number, self._ask) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def run_teleop(order: TeleopOrder, root: Path, *, as_json: bool = False) -> bool:
    """Run a session and tell what became of every attempt.

    Args:
        order: what was asked for.
        root: folder of the store; it is made where there is none.
        as_json: print one JSON object instead of a table.

    Returns:
        Whether the session was interrupted.

    Raises:
        HardcaseError: a name, a device or the disk refuses; attempts that were finished are in the store.
    """
    attempts, stop = list[Closed](), Stop()
    with Store.open(root, create=True) as store:
        number = sum(info.control == TELEOP for info in store.runs().values())
        run = short_id("teleop session", number)
        with store.lease(run) as lease:
            consent = _consent(order, store)
            try:
                _drive(order, store, lease, number, consent, stop, attempts)
            finally:
                if as_json:
                    _print_json(attempts)
                elif attempts:
                    print_attempts(attempts)
    return stop.asked


def _drive(order: TeleopOrder, store: Store, lease: Lease, number: int, consent: Consent | None, stop: Stop,
           attempts: list[Closed]) -> None:
    """Connect everything, run the attempts, and keep each as soon as it is whole."""
    driven, device = open_robot(order, number), open_device(order)
    policy, name, id = open_policy(order.policy, store) if order.policy else (None, "", None)
    _check_fit(order, driven, device)
    device = _with_keys(device)
    with store.commit(lease, lease.run) as tx:
        tx.add_run(_info(order, number))
    adopt(store, lease)
    line = StatusLine(driven.robot.signals, order.episodes, driven.robot.control_hz)
    alarm = Alarm(load_task(order.task)) if policy is not None else None
    said = record_strings(consent) if consent else {}
    session = Session(
        operator=order.operator, consent=order.consent or NO_CONSENT, folder=store.root / FOLDER,
        software={**facts.software(), **said}, config=_config(order, device), number=number,
        episodes=order.episodes, max_s=order.max_s, by_key=order.by_key,
        stop_on_trigger=order.stop_on_trigger, ring=order.ring, ask=_can_say_next(device), show=line.show,
        stop=stop)
    with ExitStack() as stack:
        riders = stack.enter_context(shadowed(order.shadows, store, order.episodes * order.max_s))
        shadow = LiveShadow(riders, cast(Arm, driven.robot)) if riders else None  # _check_fit lets no other robot pass
        controls = Controls(device, driven.driver, driven.limits, policy, name, id, alarm, driven.film, shadow)
        stack.callback(driven.robot.disconnect)
        driven.robot.connect()
        stack.callback(device.disconnect)
        device.connect()  # after the robot: its calibration may ask questions on the terminal
        print(_help(device), file=sys.stderr, flush=True)
        try:
            with stop.listening():  # not before: a Ctrl-C must end a device that does not connect
                for closed in teleop(driven.robot, controls, driven.scene_of, session):
                    keep(store, lease, closed)
                    attempts.append(closed)
        finally:
            line.end()
            print_states(riders.states() if riders else {})
            if driven.robot.late:
                print(f"{driven.robot.late} ticks came late: this machine is too slow or too busy", file=sys.stderr)


def _consent(order: TeleopOrder, store: Store) -> Consent | None:
    """The person's record; refused where it is not there or another's, and told where it does not hold now."""
    if re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", order.operator) is None:
        raise ConfigError(f"{order.operator!r} is no pseudonym", where=f"--operator {order.operator}",
                          mend="use 1 to 64 of a-z, 0-9, _ and -; never a person's name")
    told = "recordings of this session are kept, and never used for training"
    if order.consent is None:
        print(f"no consent: {told} (--consent ID)", file=sys.stderr)
        return None
    records = store.consents()
    consent = records.get(order.consent)
    if consent is None:
        raise StoreError(f"consent {order.consent} is not in the store", where=f"--consent {order.consent}",
                         mend="add it: hardcase consent add; or leave --consent away: nothing is learnt from it then")
    if consent.operator != order.operator:
        raise ConfigError(f"consent {consent.id} is of operator {consent.operator!r}",
                          where=f"--operator {order.operator}", mend=f"--operator {consent.operator}")
    flaw = Consents(records, datetime.now(UTC)).ends(consent)
    if flaw is not None:
        print(f"{flaw.reason}: {told}", file=sys.stderr)
    return consent


def _check_fit(order: TeleopOrder, driven: Driven, device: Teleoperator) -> None:
    from pipeline.frames import ENVIRONMENT, STATE
    from pipeline.robots.mapping import check_fit

    check_fit(device, driven.robot.signals, driven.robot.name)
    if order.ring and not order.policy:
        raise ConfigError("a demonstration is kept whole", where="--ring",
                          mend="name who is watched: --policy champion; or leave --ring away")
    signals = driven.robot.signals
    if (signals.state, signals.environment) == (STATE, ENVIRONMENT):
        return
    wanted = [("--policy", order.policy)] if order.policy else []
    for option, name in (*wanted, *(("--shadow", name) for name in order.shadows)):
        raise ConfigError(f"robot {driven.robot.name!r} does not perceive what a policy looks at",
                          where=f"{option} {name}",
                          mend=f"leave {option} away, or give the robot {', '.join(ENVIRONMENT)} in its observation")


def _with_keys(device: Teleoperator) -> Teleoperator:
    """The device, and beside it the keys of the session where there is a terminal."""
    return WithKeys(device, Keyboard()) if not isinstance(device, Keyboard) and sys.stdin.isatty() else device


def _help(device: Teleoperator) -> str:
    """What keys and buttons do."""
    told = [BUTTONS] if device.name == "gamepad" else []
    if isinstance(device, Keyboard | WithKeys):
        told.append(KEYS)
    return "\n".join(told) or f"{device.name} drives; attempts follow each other"


def _can_say_next(device: Teleoperator) -> bool:
    return isinstance(device, Keyboard | WithKeys) or device.name == "gamepad"


def _info(order: TeleopOrder, number: int) -> RunInfo:
    twin = int(order.robot.partition(":")[2]) if order.robot.startswith("twin:") else 0
    recipe = {"robot": order.robot, "teleop": order.teleop, "policy": order.policy, "task": order.task,
              "operator": order.operator, "consent": order.consent}
    return RunInfo(recipe_name=TELEOP, recipe={k: v for k, v in recipe.items() if v is not None}, seed=number,
                   twin=twin, control=TELEOP, command=" ".join(["hardcase", *sys.argv[1:]]), commit=facts.commit(),
                   versions=facts.versions())


def _config(order: TeleopOrder, device: Teleoperator) -> dict[str, object]:
    """What was in force; keys of devices are left out: they can hold addresses and serial numbers."""
    axes, buttons = device.raw_names
    values = {k: v for k, v in asdict(order).items() if k not in ("robot_keys", "teleop_keys", "plugins")}
    return {**values, "joy_axes": list(axes), "joy_buttons": list(buttons)}


def _print_json(attempts: list[Closed]) -> None:
    import json

    found = [{**c.episode.model_dump(mode="json"), "dropped": dict(c.dropped)} for c in attempts]
    print(json.dumps({"episodes": found}))

