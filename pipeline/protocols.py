"""What a robot, a policy, an input device, a trigger and a recorder must be able to do: the seams of the loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pipeline.recording.live_rows import Row, TickLayout
    from pipeline.triggers import Senses
    from schemas.episode import Outcome
    from schemas.scene import SceneSpec

type Array = NDArray[np.float64]
type Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Observation:
    """What n robots perceive at one tick; rows belong to the ids they were asked for."""

    state: Array
    """See pipeline.frames.STATE, shape (n, 16)."""
    environment: Array
    """See pipeline.frames.ENVIRONMENT, shape (n, 7)."""
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict[str, NDArray[np.uint8]])
    """Camera -> RGB, shape (n, height, width, 3); only those that the policy asked for, see SeeingPolicy."""


class Policy(Protocol):
    """Maps observations of n attempts to actions; may keep a memory per attempt."""

    def reset(self, n: int) -> None:
        """Forget everything and prepare for n attempts."""
        ...

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Actions (len(ids), 5) in the order of ids; see pipeline.frames.ACTION."""
        ...

    def memory(self, ids: Ids) -> Array:
        """The memory of the attempts as rows (len(ids), w), w may be 0: part of a restorable state."""
        ...


@runtime_checkable
class SeeingPolicy(Policy, Protocol):
    """A policy that wants pictures."""

    @property
    def cameras(self) -> Mapping[str, tuple[int, int]]:
        """Camera -> height and width of the pictures that it wants [px]."""
        ...


class Robot(Protocol):
    """n robots side by side, real or simulated, that act and perceive on one control clock."""

    control_hz: float

    def observe(self, ids: Ids) -> Observation:
        """What the robots perceive now; never the simulator's truth."""
        ...

    def act(self, action: Array, ids: Ids) -> None:
        """Send actions (len(ids), 5) and let one control period pass."""
        ...


@dataclass(frozen=True, slots=True)
class Signals:
    """What the columns of a robot's observations and actions are; those of the arm stand in pipeline.frames."""

    state: tuple[str, ...]
    environment: tuple[str, ...]
    """Empty where the robot does not perceive what it works on."""
    action: tuple[str, ...]


class LiveRobot(Robot, Protocol):
    """One robot in time, simulated or on a table, that people drive and that is recorded; its id is 0."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def signals(self) -> Signals:
        """Its columns."""
        ...

    @property
    def judge(self) -> Literal["simulator", "sensors", "operator"]:
        """Who says whether an attempt has succeeded: `succeeded` of a robot that a person judges is never true."""
        ...

    @property
    def late(self) -> int:
        """Ticks so far that came over half a period late."""
        ...

    def connect(self) -> None:
        """Make it ready to perceive and act; RobotError says what is missing."""
        ...

    def disconnect(self) -> None:
        """Let it go; may be called twice."""
        ...

    def begin(self, scene: "SceneSpec") -> None:
        """Start an attempt: a simulated robot is put at its start, a real one stays where it is."""
        ...

    def succeeded(self) -> bool:
        """Whether the attempt has succeeded, as far as `judge` can tell."""
        ...

    def phase(self) -> str:
        """Subtask that the attempt has reached; empty where the robot cannot tell."""
        ...

    def row(self) -> "Row | Array":
        """What a recording keeps of the tick that was observed and acted last."""
        ...

    def layout(self) -> "TickLayout | None":
        """How `row` is recorded; None where it is a Row of the reference arm."""
        ...

    def pictures(self) -> Mapping[str, NDArray[np.uint8]]:
        """Camera -> what it saw at the last observation, RGB, shape (height, width, 3)."""
        ...

    def attachments(self) -> Mapping[str, bytes]:
        """Files that a recording carries: robot.urdf and scene.xml, where there are any."""
        ...


@dataclass(frozen=True, slots=True)
class Picture:
    """What one camera saw."""

    camera: str
    pixels: NDArray[np.uint8] | bytes
    """RGB, shape (height, width, 3), or a JPEG as many cameras give it."""
    stamp_ns: int | None = None
    """When it was taken, on the recording's clock; when it is handed on where None [ns]."""
    tick: int | None = None
    """The tick whose state it shows; the one that comes next where None."""


class Cameras(Protocol):
    """Any number of cameras, rendered or real; all methods are called in one thread of their own."""

    skipped: int
    """Moments that should have been taken and were not: rendering, or the wire, is slower than the robot."""

    def open(self) -> None:
        """Make them ready; HardcaseError says what is missing."""
        ...

    def read(self, timeout_s: float) -> Sequence[Picture]:
        """Pictures that are new since the last call; none after `timeout_s` [s]. HardcaseError where one is gone."""
        ...

    def close(self) -> None:
        """Give them back; may be called where `open` has failed."""
        ...


type Call = Literal["take-over", "success", "failure", "unknown", "next", "quit"]
"""What a person says to the session rather than to the robot."""


@dataclass(frozen=True, slots=True)
class Command:
    """What a person's input device says at one tick."""

    axes: tuple[float, ...] = ()
    """Shares of full speed in [-1, 1]: x, y, z, yaw, then spare ones for robots with more joints."""
    grip: float = 0.0
    """Share of the gripper's full speed in [-1, 1]: opening above 0, closing below."""
    targets: Mapping[str, float] = field(default_factory=dict[str, float])
    """Joint -> where it is to go, in the robot's own unit; empty for a device that gives axes."""
    calls: frozenset[Call] = frozenset()
    """What was said to the session since the last reading."""
    intervening: bool | None = None
    """Whether the device's own switch for taking over is held; None where it has none."""
    raw_axes: tuple[float, ...] = ()
    """The device's analogue values before any mapping, as they go to /teleop/joy."""
    raw_buttons: tuple[int, ...] = ()


class Teleoperator(Protocol):
    """A person's input device, read once a tick."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def raw_names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the raw axes and of the raw buttons."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that it gives targets for; empty for a device that gives axes."""
        ...

    def connect(self) -> None:
        """Open the device; RobotError says what is missing."""
        ...

    def read(self) -> Command:
        """What the person does now; never waits. RobotError where the device is gone."""
        ...

    def disconnect(self) -> None:
        """Give the device back; may be called twice."""
        ...


class Trigger(Protocol):
    """Notices one kind of failure from what the robots sense; see pipeline.triggers.TRIGGERS."""

    def __call__(self, senses: "Senses", /) -> NDArray[np.bool_]:
        """Which attempts have failed so, shape (n,)."""
        ...


class Recorder(Protocol):
    """Takes what happens and makes it a file that is whole or absent; every call but the last returns at once.

    A call returns False where the message was lost: the queue is full, or the disk has failed.
    """

    def tick(self, tick: int, row: "Row | Array", *, stamp_ns: int | None = None) -> bool:
        """All messages of one tick, or none of them."""
        ...

    def write(self, topic: str, payload: bytes, *, tick: int | None = None, stamp_ns: int | None = None) -> bool:
        """One message of a topic of the dialect, encoded already."""
        ...

    def image(self, camera: str, picture: NDArray[np.uint8] | bytes, *, tick: int | None = None,
              stamp_ns: int | None = None) -> bool:
        """What a camera saw, RGB of shape (height, width, 3), or a JPEG."""
        ...

    def segment(self, kind: str, actor: str, *, tick: int | None = None) -> bool:
        """From this tick on somebody else commands."""
        ...

    def close(self, outcome: "Outcome | None" = None) -> object:
        """Finish the file; raises what the disk reported first."""
        ...
