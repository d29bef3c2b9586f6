"""Any teleoperator of LeRobot, or of its plugins, as an input device."""

# lerobot is partly untyped
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pipeline.errors import RobotError, one_line
from pipeline.protocols import Call, Command
from pipeline.robots.driver import asked
from pipeline.robots.mapping import DELTAS, plain

if TYPE_CHECKING:
    from lerobot.teleoperators import Teleoperator as Device

GRIP = "gripper"
STAY = 1.0
"""lerobot's gripper action for 'stay'; 0 closes, 2 opens. Source: lerobot 0.6, teleop_gamepad.GripperAction."""


class LerobotTeleop:
    """Implements pipeline.protocols.Teleoperator.

    A device whose action is `delta_x`, `delta_y`, `delta_z` (and `delta_yaw`, `gripper`) gives axes; any other
    gives targets by name. Where lerobot's `get_teleop_events` is there, its events speak to the session.

    Args:
        device: of lerobot, not yet connected.
        name: as registered.

    Raises:
        RobotError: its action is not a set of numbers.
    """

    def __init__(self, device: "Device", name: str) -> None:
        self._device, self.name = device, f"lerobot:{name}"
        self._names = feature_names(device, "action_features", f"--teleop lerobot:{name}")
        self._axes = set(self._names) <= {*DELTAS, GRIP}
        self.joints = () if self._axes else tuple(plain(n) for n in self._names)
        self.raw_names = (self._names, ())
        self._ended = False

    def connect(self) -> None:
        """Connect it, and calibrate it where lerobot asks for that."""
        asked(self.name, "does not connect", self._device.connect, where=f"--teleop {self.name}",
              mend="check cable, port and rights; try lerobot-teleoperate with them")

    def read(self) -> Command:
        """Its action of now."""
        found: Mapping[str, Any] = asked(self.name, "does not answer", self._device.get_action,
                                         where=f"--teleop {self.name}",
                                         mend="the attempt was kept; check the cable, then start again")
        values = {name: number(found, name, self.name) for name in self._names}
        raw = tuple(values.values())
        calls, intervening = self._events()
        if not self._axes:
            return Command(targets={plain(n): v for n, v in values.items()}, calls=calls, intervening=intervening,
                           raw_axes=raw)
        axes = tuple(values.get(name, 0.0) for name in DELTAS)
        return Command(axes=axes, grip=values.get(GRIP, STAY) - STAY, calls=calls, intervening=intervening,
                       raw_axes=raw)

    def _events(self) -> tuple[frozenset[Call], bool | None]:
        """What lerobot's own buttons say; a button that stays down speaks once."""
        ask: Any = getattr(self._device, "get_teleop_events", None)
        if ask is None:
            return frozenset(), None
        events = {getattr(key, "value", key): bool(value) for key, value in ask().items()}
        call: Call | None = None
        if events.get("success"):
            call = "success"
        elif events.get("rerecord_episode"):
            call = "unknown"
        elif events.get("terminate_episode"):
            call = "failure"
        new = call is not None and not self._ended
        self._ended = call is not None
        return (frozenset({call}) if new and call else frozenset()), events.get("is_intervention", False)

    def disconnect(self) -> None:
        """Give the device back."""
        if self._device.is_connected:
            self._device.disconnect()


def feature_names(device: Any, kind: str, where: str) -> tuple[str, ...]:
    """Names of the numbers among a lerobot device's features, in its order; pictures are left out.

    Raises:
        RobotError: it tells none.
    """
    try:
        features: dict[str, Any] = getattr(device, kind)
    except Exception as error:  # lerobot's plain keyboard cannot tell its own
        raise RobotError(f"it does not say what its {kind} are: {one_line(error)}", where=where,
                         mend="use another one, or our own: keyboard, gamepad") from error
    if "names" in features and "shape" in features:
        return tuple(features["names"])
    odd = [name for name, type_ in features.items() if not _is_number(type_) and not isinstance(type_, tuple)]
    if odd or not features:
        what = f"{', '.join(odd)} are not numbers" if odd else "it has none"
        raise RobotError(f"its {kind} cannot be used: {what}", where=where,
                         mend="use one whose features are joint positions or delta_x, delta_y, delta_z")
    return tuple(name for name, type_ in features.items() if _is_number(type_))


def number(values: Mapping[str, Any], name: str, device: str) -> float:
    """One value of an action or observation.

    Raises:
        RobotError: it is missing or no number; NaN is one, and the guard's business.
    """
    try:
        return float(values[name])
    except (KeyError, TypeError, ValueError) as error:
        what = "is missing" if name not in values else f"is {values[name]!r}, not a number"
        raise RobotError(f"{name} of {device} {what}", where=device,
                         mend="its features promise it: report this to the plugin's author") from error


def _is_number(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, int | float)
