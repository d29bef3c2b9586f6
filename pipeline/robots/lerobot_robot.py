"""Any robot of LeRobot, or of its plugins, by its joints: targets go through by name."""

# lerobot is partly untyped
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError, RobotError
from pipeline.protocols import Array, Ids, Observation, Signals
from pipeline.recording import cdr
from pipeline.recording.live_rows import TickLayout
from pipeline.robots.driver import asked
from pipeline.robots.lerobot_teleop import feature_names, number
from pipeline.robots.limits import Limits
from pipeline.robots.mapping import RATES
from pipeline.robots.pace import Pace
from schemas.scene import SceneSpec

if TYPE_CHECKING:
    from lerobot.robots import Robot as Device


class Link:
    """A lerobot robot whose failures are RobotErrors, and whose observations are checked.

    Args:
        device: of lerobot, not yet connected.
        name: as registered.

    Raises:
        RobotError: its features are not numbers and pictures.
    """

    def __init__(self, device: "Device", name: str) -> None:
        self._device, self.name = device, f"lerobot:{name}"
        where = f"--robot {self.name}"
        self.acts = feature_names(device, "action_features", where)
        self.senses = feature_names(device, "observation_features", where)
        self.pictures: dict[str, NDArray[np.uint8]] = {}

    def connect(self) -> None:
        """Connect it, and calibrate it where lerobot asks for that."""
        asked(self.name, "does not connect", self._device.connect, where=f"--robot {self.name}",
              mend="check power, port and rights; try lerobot-teleoperate with them")

    def disconnect(self) -> None:
        """Let it go, as the driver does that: many switch the motors off."""
        if self._device.is_connected:
            self._device.disconnect()

    def observe(self) -> dict[str, float]:
        """Name -> measured value; pictures are kept beside.

        Raises:
            RobotError: the driver fails, a feature is missing, or a value is not finite.
        """
        found: Mapping[str, Any] = self._asked("does not answer", self._device.get_observation)
        values = {name: number(found, name, self.name) for name in self.senses}
        if bad := [name for name, value in values.items() if not np.isfinite(value)]:
            raise RobotError(f"{bad[0]} of {self.name} is measured as {values[bad[0]]}", where=self.name,
                             mend="check its cable and calibration; the attempt was kept up to here")
        self.pictures = {name: np.ascontiguousarray(value) for name, value in found.items()
                         if isinstance(value, np.ndarray) and value.ndim == 3 and value.dtype == np.uint8
                         and value.shape[2] == 3}
        return values

    def send(self, values: Mapping[str, float]) -> dict[str, float]:
        """Send targets; returns what the driver says that it sent."""
        sent: Mapping[str, Any] | None = self._asked("refuses an action", self._device.send_action, dict(values))
        return {name: float((sent or values).get(name, value)) for name, value in values.items()}

    def _asked(self, what: str, call: Any, *arguments: object) -> Any:
        return asked(self.name, what, call, *arguments, where=f"--robot {self.name}",
                     mend="the attempt was kept; check power and cable, then start again")


class JointRobot:
    """Implements pipeline.protocols.LiveRobot for a robot that only LeRobot knows: its action is its joint targets.

    Nobody here can tell whether an attempt has succeeded: a person says so.

    Args:
        link: to the robot.
        hz: control rate [Hz].
        max_step: largest change of a target from one tick to the next, in the robot's own unit; of a speed, its
            largest value. The key "" stands for every action feature that has no key of its own.

    Raises:
        ConfigError: a feature has no largest step.
        RobotError: a joint is commanded that is not measured.
    """

    judge: Literal["operator"] = "operator"

    def __init__(self, link: Link, hz: float, max_step: Mapping[str, float]) -> None:
        self._link, self.name, self.control_hz = link, link.name, hz
        rate = np.array([name.endswith(RATES) for name in link.acts])
        if blind := [n for n, r in zip(link.acts, rate, strict=True) if not r and n not in link.senses]:
            raise RobotError(f"{link.name} does not measure {', '.join(blind)}", where=f"--robot {link.name}",
                             mend="use a robot whose observation holds the joints of its action")
        first = tuple(n for n in link.acts if n in link.senses)
        others = tuple(n for n in link.senses if n not in link.acts)
        self.signals = Signals((*first, *others), (), link.acts)
        steps = _steps(link, max_step)
        self.limits = Limits(low=np.where(rate, -steps, -np.inf), high=np.where(rate, steps, np.inf),
                             step=np.where(rate, np.inf, steps))
        self.jog = steps
        self._pace, self._seen, self._sent = Pace(hz), np.zeros(len(self.signals.state)), np.zeros(len(link.acts))

    def connect(self) -> None:
        """Connect the robot."""
        self._link.connect()

    def disconnect(self) -> None:
        """Let it go."""
        self._link.disconnect()

    def begin(self, scene: SceneSpec) -> None:
        """An attempt begins where the robot stands."""
        self._pace.restart()

    def observe(self, ids: Ids) -> Observation:
        """Measured values in the order of signals.state; nothing of the object is perceived."""
        found = self._link.observe()
        self._seen = np.array([found[name] for name in self.signals.state])
        return Observation(self._seen[None], np.zeros((1, 0)))

    def act(self, action: Array, ids: Ids) -> None:
        """Send targets (1, k) and let one control period pass."""
        sent = self._link.send(dict(zip(self.signals.action, map(float, action[0]), strict=True)))
        self._sent = np.array(list(sent.values()))
        self._pace.wait()

    def succeeded(self) -> bool:
        """Never: a person judges."""
        return False

    def phase(self) -> str:
        """Nobody here knows."""
        return ""

    def row(self) -> Array:
        """Measured values, then the targets that were sent."""
        return np.concatenate([self._seen, self._sent])

    def layout(self) -> TickLayout:
        """Two JointStates with the robot's own names."""
        state, action = self.signals.state, self.signals.action
        plain = {"velocity": False, "effort": False}
        return TickLayout([
            ("/joint_states", cdr.joint_state(state, **plain), np.arange(len(state))),
            ("/joint_commands", cdr.joint_state(action, **plain), len(state) + np.arange(len(action)))])

    def pictures(self) -> Mapping[str, NDArray[np.uint8]]:
        """Its cameras, as LeRobot read them."""
        return self._link.pictures

    def attachments(self) -> Mapping[str, bytes]:
        """None: LeRobot does not tell a robot's URDF."""
        return {}

    @property
    def late(self) -> int:
        """Ticks that came late."""
        return self._pace.late


def _steps(link: Link, max_step: Mapping[str, float]) -> Array:
    """The largest step of every action feature; there is no safe default, for their units are the robot's own."""
    if unknown := sorted(set(max_step) - {"", *link.acts}):
        raise ConfigError(f"{link.name} has no action {', '.join(unknown)}", where="--max-step",
                          mend=f"use: {', '.join(link.acts)}")
    without = [name for name in link.acts if name not in max_step and "" not in max_step]
    if without:
        raise ConfigError(f"nobody said how far {', '.join(without)} may move in a tick", where=f"--robot {link.name}",
                          mend="--max-step 2 where the robot counts in degrees or percent, 0.03 where in radians")
    steps = np.array([max_step.get(name, max_step.get("", 0.0)) for name in link.acts])
    if not (np.isfinite(steps) & (steps > 0)).all():
        raise ConfigError("a largest step must be above 0", where="--max-step", mend="--max-step 2")
    return steps
