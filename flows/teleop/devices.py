"""What `hardcase teleop` names on its command line, opened: robots, input devices, policies, starts."""

import re
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import ConfigError, SimulationError, StoreError
from pipeline.protocols import LiveRobot, Observation, Policy, Teleoperator
from pipeline.recording.live import LiveRecorder
from pipeline.recording.ring import RingRecorder
from pipeline.robots.limits import Limits
from pipeline.robots.mapping import Driver
from pipeline.robots.session import Film, no_film
from pipeline.store import Store
from schemas.scene import SceneSpec

if TYPE_CHECKING:
    from pipeline.robots.lerobot_robot import Link
    from pipeline.simulation.world import World

ROBOTS, DEVICES = ("arm", "twin:SEED", "lerobot:NAME"), ("keyboard", "gamepad", "lerobot:NAME")


@dataclass(frozen=True, slots=True)
class TeleopOrder:
    """A session as it was asked for on the command line."""

    robot: str = "arm"
    robot_keys: Mapping[str, str] = field(default_factory=dict[str, str])
    teleop: str = "keyboard"
    teleop_keys: Mapping[str, str] = field(default_factory=dict[str, str])
    plugins: Sequence[str] = ()
    policy: str | None = None
    shadows: tuple[str, ...] = ()
    task: str = "pick-place"
    stratum: str | None = None
    operator: str = "anonymous"
    consent: str | None = None
    episodes: int = 1
    cameras: tuple[str, ...] = ()
    size: tuple[int, int] = (320, 240)
    hz: float = 20.0
    speed: float = 1.0
    hand_speed: float = 1.0
    max_step: Mapping[str, float] = field(default_factory=dict[str, float])
    max_s: float = 120.0
    by_key: bool = False
    stop_on_trigger: bool = False
    ring: bool = False


@dataclass(frozen=True, slots=True)
class Driven:
    """A robot with everything that depends on its kind."""

    robot: LiveRobot
    driver: Driver
    limits: Limits
    scene_of: Callable[[int, Observation], SceneSpec]
    film: Film = no_film
    """Films an attempt with cameras that are no part of the robot."""


def open_robot(order: TeleopOrder, session: int) -> Driven:
    """The robot that an order names, not yet connected.

    Args:
        order: names and options.
        session: number of the session; its starts are drawn from it and no other session has them.

    Raises:
        ConfigError: an unknown name, key or value.
        HardcaseError: what the robot's kind needs is missing here.
    """
    kind, _, rest = order.robot.partition(":")
    if kind == "lerobot" and rest:
        return _lerobot(order, rest, session)
    if order.robot == "arm" or (kind == "twin" and rest.isdecimal()):
        return _simulated(order, int(rest) if kind == "twin" else None, session)
    raise ConfigError(f"unknown robot {order.robot!r}", where="--robot", mend=f"use one of: {', '.join(ROBOTS)}")


def _simulated(order: TeleopOrder, twin: int | None, session: int) -> Driven:
    from pipeline.robots.mapping import ArmDriver
    from pipeline.robots.simulated import ARM_LIMITS, SimulatedRobot
    from pipeline.simulation.bodies import load_body
    from pipeline.simulation.model import compose
    from pipeline.simulation.physics import from_draws
    from pipeline.simulation.tasks import load_task, sample_scene, scene_seed
    from pipeline.simulation.world import World
    from pipeline.twin.twin import draw_twin, twin_world

    strata = (order.stratum,) if order.stratum else load_task(order.task).common

    def scene_of(attempt: int, seen: Observation | None = None) -> SceneSpec:
        return sample_scene(order.task, "teleop", scene_seed("teleop", session, attempt),
                            strata[attempt % len(strata)], twin=twin)

    if twin is None:
        world = World(compose(load_body("arm"), "table"), [scene_of(0)], from_draws([()]), threads=1)
    else:
        world = twin_world(draw_twin(twin), [scene_of(0)], threads=1)
    robot = SimulatedRobot(world, order.robot.replace(":", "-"), judged=twin is None, speed=order.speed)
    driver = ArmDriver(robot.control_hz, robot.pose_of, speed=order.hand_speed)
    return Driven(robot, driver, ARM_LIMITS, scene_of, _scene_cameras(world, order))


def _scene_cameras(world: "World", order: TeleopOrder) -> Film:
    """Renders the cameras of an order beside each attempt; where nothing renders, the attempt goes on without."""
    from pipeline.recording.filming import Filming
    from pipeline.simulation.live_cameras import SceneCameras

    one = np.arange(1)

    def cameras() -> SceneCameras:
        width, height = order.size
        return SceneCameras(world.batch.get_model(0), order.cameras, width=width, height=height)

    cameras()  # an unknown name is refused now, not at the first attempt

    @contextmanager
    def film(recorder: LiveRecorder | RingRecorder) -> Generator[Callable[[int, int], None]]:
        if not order.cameras:
            yield lambda tick, stamp_ns: None
            return
        scene = cameras()
        try:
            filming = Filming(recorder, scene)
        except SimulationError as error:
            print(f"no pictures: {error.what}; recording goes on without ({error.mend})", file=sys.stderr)
            yield lambda tick, stamp_ns: None
            return
        with filming:
            yield lambda tick, stamp_ns: scene.show(world.save(one)[0][0], tick, stamp_ns)

    return film


def _lerobot(order: TeleopOrder, name: str, session: int) -> Driven:
    from pipeline.robots.lerobot_arm import ArmRobot, is_arm
    from pipeline.robots.lerobot_robot import JointRobot, Link
    from pipeline.robots.mapping import ArmDriver, JointDriver
    from pipeline.robots.plugins import make_robot
    from pipeline.robots.simulated import ARM_LIMITS
    from pipeline.simulation.tasks import load_task

    _refuse_simulators_options(order)
    task = load_task(order.task)
    link = Link(make_robot(name, order.robot_keys, order.plugins), name)
    scene_of = _real_scenes(order, link, session)
    if is_arm(link):
        arm = ArmRobot(link, task, order.hz)
        return Driven(arm, ArmDriver(order.hz, arm.pose_of, speed=order.hand_speed), ARM_LIMITS, scene_of)
    robot = JointRobot(link, order.hz, order.max_step)
    return Driven(robot, JointDriver(robot.signals, robot.jog * min(1.0, order.hand_speed)), robot.limits, scene_of)


def _refuse_simulators_options(order: TeleopOrder) -> None:
    for option, given in (("--camera", order.cameras), ("--stratum", order.stratum), ("--speed", order.speed != 1)):
        if given:
            raise ConfigError(f"{option} is for simulated robots", where=f"--robot {order.robot}",
                              mend="cameras of a LeRobot robot are part of its config: --robot-key cameras='{...}'")


def _real_scenes(order: TeleopOrder, link: "Link", session: int) -> Callable[[int, Observation], SceneSpec]:
    """Starts as a real robot perceives them; where it perceives no object, zeros stand in the scene 'real'."""
    from pipeline.frames import ENVIRONMENT
    from pipeline.robots.lerobot_arm import is_arm
    from pipeline.simulation.tasks import load_task, scene_seed
    from pipeline.triggers import stratum_of

    task, arm = load_task(order.task), is_arm(link)
    registered = re.sub(r"[^a-z0-9_-]", "-", link.name.partition(":")[2].lower())
    name = "arm" if arm and set(ENVIRONMENT) <= set(link.senses) else registered

    def scene_of(attempt: int, seen: Observation) -> SceneSpec:
        there = seen.environment[0] if seen.environment.size else None
        x, y, z, yaw, to_x, to_y = (0.0, 0.0, 0.02, 0.0, 0.0, 0.0) if there is None else map(float, there[:6])
        return SceneSpec(family="teleop", seed=scene_seed("teleop", session, attempt), robot=name, scene="real",
                         task=order.task, stratum="unknown" if there is None else stratum_of(there),
                         object_xy_m=(x, y), object_yaw_rad=yaw, object_half_m=task.nearest_half(z),
                         target_xy_m=(to_x, to_y))

    return scene_of


def open_device(order: TeleopOrder) -> Teleoperator:
    """The input device that an order names, not yet connected.

    Raises:
        ConfigError: an unknown name, key or value.
        RobotError: its driver is missing.
    """
    kind, _, rest = order.teleop.partition(":")
    if order.teleop == "keyboard":
        from pipeline.robots.keyboard import Keyboard

        return Keyboard()
    if order.teleop == "gamepad":
        from pipeline.robots.gamepad import Gamepad

        return Gamepad()
    if kind == "lerobot" and rest:
        from pipeline.robots.lerobot_teleop import LerobotTeleop
        from pipeline.robots.plugins import make_teleoperator

        return LerobotTeleop(make_teleoperator(rest, order.teleop_keys, order.plugins), rest)
    raise ConfigError(f"unknown teleoperator {order.teleop!r}", where="--teleop",
                      mend=f"use one of: {', '.join(DEVICES)}")


def open_policy(name: str, store: Store) -> tuple[Policy, str, str | None]:
    """A policy to take over from, its name for the recording, and its id in the store.

    Args:
        name: 'expert', 'champion' for that of the newest loop, or the beginning of a policy's id.
        store: where policies are.

    Raises:
        StoreError: there is no such policy, or nothing is released.
        PolicyError: its file is refused.
    """
    if name == "expert":
        from pipeline.simulation.expert import Expert

        return Expert(), "expert", None
    id = policy_id(name, store)
    from pipeline.policies.onnx_policy import OnnxPolicy

    return OnnxPolicy(store.path(store.policy(id).checkpoint) / "policy.onnx"), id, id


def policy_id(name: str, store: Store, option: str = "--policy") -> str:
    """Id of a policy: 'champion' for that of the newest loop, or the beginning of an id; StoreError as above."""
    if name == "champion":
        return _champion(store, option)
    table, id = store.find(name)
    if table != "policy":
        raise StoreError(f"{name} is a {table}, not a policy", where=option,
                         mend=f"name a policy's id{', champion or expert' if option == '--policy' else ' or champion'}")
    return id


def _champion(store: Store, option: str) -> str:
    loops = {run for run, info in store.runs().items() if not info.control}
    for (run,) in store.query("SELECT run FROM invocation ORDER BY rowid DESC"):
        if run in loops and (champion := store.champion(str(run))) is not None:
            return champion.policy
    raise StoreError("no loop of this store has released a policy", where=f"{option} champion",
                     mend="turn one first: hardcase loop" + ("; or use --policy expert" * (option == "--policy")))
