"""`hardcase record`: a simulated robot at work in real time, recorded as a real one would be."""

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flows.run import facts
from flows.run.signalling import neighbours_of
from flows.teleop.devices import TeleopOrder, open_policy, open_robot
from flows.teleop.shadowing import print_states, shadowed
from flows.teleop.teleoperation import Stop
from pipeline.errors import ConfigError, SimulationError
from pipeline.files import short_id
from pipeline.protocols import Policy
from pipeline.recording.filming import Filming
from pipeline.recording.live import Closed, LiveRecorder
from pipeline.recording.live_header import beginning
from pipeline.recording.ring import RingRecorder
from pipeline.shadow.live import LiveShadow
from pipeline.shadow.riders import Riders
from pipeline.signals.live import LiveWatch
from pipeline.simulation.tasks import load_task
from pipeline.store import Store
from schemas.scene import SceneSpec
from stages.record import record

if TYPE_CHECKING:
    from pipeline.robots.simulated import SimulatedRobot

_ONE = np.arange(1)


@dataclass(frozen=True, slots=True)
class RecordOrder:
    """A recording as it was asked for on the command line."""

    path: Path
    robot: str = "arm"
    policy: str = "expert"
    shadows: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    size: tuple[int, int] = (320, 240)
    seconds: float = 10.0
    until_success: bool = False
    seed: int = 0
    stratum: str | None = None
    ring: bool = False


def run_record(order: RecordOrder, root: Path, *, as_json: bool = False) -> bool:
    """Record one attempt and print what became of it.

    Args:
        order: what was asked for.
        root: folder of the store that policies are taken from.
        as_json: print one JSON object.

    Returns:
        Whether it was interrupted; it is closed then too, with outcome 'unknown'.

    Raises:
        HardcaseError: a name or the disk refuses.
    """
    policy, actor, policy_id = _policy(order.policy, root)
    robot, scene = _robot(order)
    stop = Stop()
    attachments = {**robot.attachments(), "config.json": _config(order),
                   "randomization.json": json.dumps([draw.model_dump() for draw in scene.draws]).encode()}
    episode = beginning(
        id=short_id("record", scene.model_dump_json(), actor, order.path.name), kind="autonomous", actor=actor,
        origin="scripted" if policy_id is None else "deployed", scene=scene, control_hz=robot.control_hz,
        generation=0, policy=policy_id)
    film = _Film(order, robot)
    with _riders(order, root) as riders:
        make = RingRecorder if order.ring else LiveRecorder
        with make(order.path, episode, attachments=attachments, software=facts.software()) as recorder:
            with stop.listening(), film.on(recorder):
                robot.begin(scene)
                outcome = record(robot, policy, recorder, seconds=order.seconds, until_success=order.until_success,
                                 show=film.show, stop=stop, shadow=LiveShadow(riders, robot) if riders else None,
                                 watch=_watch(order, scene, policy_id, root))
            closed = recorder.close(outcome)
        states = riders.states() if riders else {}
    windows = recorder.windows if isinstance(recorder, RingRecorder) else None
    _print(closed, film.taken, robot.late, states, windows, as_json=as_json)
    return stop.asked


class _Film:
    """The cameras of a recording, or nothing where none is asked for or nothing can render here."""

    def __init__(self, order: RecordOrder, robot: "SimulatedRobot") -> None:
        from pipeline.simulation.live_cameras import SceneCameras

        width, height = order.size
        self._robot, self.taken = robot, dict[str, int]()
        self._cameras = SceneCameras(robot.world.batch.get_model(0), order.cameras, width=width, height=height)
        self._filming = False

    @contextmanager
    def on(self, recorder: LiveRecorder | RingRecorder) -> Iterator[None]:
        """Film while the body runs; where that is impossible, say so in one line and go on without."""
        with ExitStack() as stack:
            filming = None
            if self._cameras.names:
                try:
                    filming = stack.enter_context(Filming(recorder, self._cameras))
                    self.taken, self._filming = filming.taken, True
                except SimulationError as error:
                    print(f"no pictures: {error.what}; recording goes on without ({error.mend})", file=sys.stderr)
            yield
        if self._cameras.skipped:
            print(f"{self._cameras.skipped} states were not filmed: rendering is slower than the robot "
                  "(fewer cameras, or a smaller --size)", file=sys.stderr)
        if filming and filming.error:
            print(f"no pictures since then: {filming.error.what} ({filming.error.mend})", file=sys.stderr)

    def show(self, tick: int, stamp_ns: int) -> None:
        """Let the cameras take the state that the robot is in."""
        if self._filming:
            self._cameras.show(self._robot.world.save(_ONE)[0][0], tick, stamp_ns)


def _policy(name: str, root: Path) -> tuple[Policy, str, str | None]:
    if name == "expert":
        from pipeline.simulation.expert import Expert

        return Expert(), "expert", None
    with Store.open(root) as store:
        return open_policy(name, store)


@contextmanager
def _riders(order: RecordOrder, root: Path) -> Iterator[Riders | None]:
    with ExitStack() as stack:
        if not order.shadows:
            yield None
            return
        with Store.open(root) as store:
            riders = stack.enter_context(shadowed(order.shadows, store, order.seconds))
        yield riders


def _watch(order: RecordOrder, scene: SceneSpec, policy: str | None, root: Path) -> LiveWatch | None:
    """Who computes signals: where somebody rides along, or a ring has to know what is worth keeping."""
    if not (order.ring or order.shadows):
        return None
    task = load_task(scene.task)
    if policy is None:
        return LiveWatch(task)
    with Store.open(root) as store:
        return LiveWatch(task, neighbours_of(policy, store))


def _robot(order: RecordOrder) -> tuple["SimulatedRobot", SceneSpec]:
    if order.robot.startswith("lerobot:"):
        raise ConfigError("a policy alone does not move a real robot", where=f"--robot {order.robot}",
                          mend="have a person beside it: hardcase teleop --robot NAME --policy ID")
    from pipeline.robots.simulated import SimulatedRobot

    driven = open_robot(TeleopOrder(robot=order.robot, stratum=order.stratum), order.seed)
    assert isinstance(driven.robot, SimulatedRobot)
    return driven.robot, driven.scene_of(0, driven.robot.observe(_ONE))


def _config(order: RecordOrder) -> bytes:
    """What was in force; no path of this machine."""
    return json.dumps({**asdict(order), "path": order.path.name}, sort_keys=True).encode()


def _print(closed: Closed, filmed: dict[str, int], late: int, states: Mapping[str, str],
           windows: list[Closed] | None, *, as_json: bool) -> None:
    episode = closed.episode
    if as_json:
        print(json.dumps({"path": str(closed.path), "episode": episode.model_dump(mode="json"), "pictures": filmed,
                          "dropped": dict(closed.dropped), "late_ticks": late,
                          **({"shadows": dict(states)} if states else {}),
                          **({} if windows is None else {"windows": [
                              {"path": str(w.path), "episode": w.episode.model_dump(mode="json")} for w in windows]})}))
        return
    print_states(states)
    said = f"{episode.duration_s:.1f} s, {episode.frames} ticks, outcome {episode.outcome.label}"
    pictures = "".join(f", {count} pictures of {name}" for name, count in filmed.items())
    lost = f"; dropped {dict(closed.dropped)}" if closed.dropped else ""
    print(f"{closed.path}: {said}{pictures}{lost}")
    for window in windows or ():
        kept = window.episode
        print(f"{window.path}: {kept.duration_s:.1f} s at {kept.control_hz:g} Hz, {kept.outcome.reason}")
    print(f"look at it: rerun {windows[0].path if windows else closed.path}")
