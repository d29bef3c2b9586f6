"""Gamepad: any controller that SDL knows, by its standard layout (Xbox, PlayStation, Switch, hundreds more)."""

# pygame is a compiled package; its stubs leave parts of the controller API open
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false

import os
import warnings
from types import MappingProxyType
from typing import TYPE_CHECKING

from pipeline.errors import RobotError
from pipeline.protocols import Call, Command

if TYPE_CHECKING:
    from pygame._sdl2.controller import Controller

DEADZONE = 0.12
"""Share of a stick's travel that counts as nothing: sticks do not come back to the middle exactly."""
FULL = 32767
"""Value of a stick at its end."""
AXES = ("left_x", "left_y", "right_x", "right_y", "trigger_left", "trigger_right")
"""In the order of SDL's SDL_GameControllerAxis."""
BUTTONS = ("a", "b", "x", "y", "back", "guide", "start", "left_stick", "right_stick", "left_shoulder",
           "right_shoulder", "up", "down", "left", "right")
"""In the order of SDL's SDL_GameControllerButton; a is the lower one of the four, whatever is printed on it."""
CALLS: MappingProxyType[str, Call] = MappingProxyType({
    "right_shoulder": "take-over", "y": "success", "b": "failure", "x": "unknown", "start": "next", "back": "quit",
})
"""Button -> what it says to the session."""
HELP = ("left stick move  right stick up/down and turn  left trigger close  right trigger open  "
        "d-pad joints 5, 6  RB take over  Y success  B failure  X unknown  START next  BACK quit")
MISSING = "install it: uv sync --extra gamepad"


class Gamepad:
    """Implements pipeline.protocols.Teleoperator with the first controller, or the one given.

    Args:
        index: which of the connected controllers, from 0.
    """

    name = "gamepad"
    raw_names = (AXES, BUTTONS)
    joints: tuple[str, ...] = ()

    def __init__(self, index: int = 0) -> None:
        self._index = index
        self._pad: Controller | None = None
        self._held: frozenset[str] = frozenset()

    def connect(self) -> None:
        """Open the controller; no window and no display are needed."""
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        os.environ.setdefault("SDL_NO_SIGNAL_HANDLERS", "1")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            with warnings.catch_warnings():  # pygame 2.6 asks for a part of setuptools that warns of its end
                warnings.simplefilter("ignore")
                import pygame
                from pygame._sdl2 import controller
        except ImportError as error:
            raise RobotError("pygame is not installed", where="--teleop gamepad", mend=MISSING) from error
        pygame.display.init()
        controller.init()
        if self._index >= controller.get_count() or not controller.is_controller(self._index):
            raise RobotError(f"no gamepad {self._index}; {controller.get_count()} devices are connected",
                             where="--teleop gamepad",
                             mend="plug it in, and let your user read it: sudo usermod -aG input USER")
        self._pad = controller.Controller(self._index)

    def disconnect(self) -> None:
        """Give the controller back."""
        if self._pad is not None:
            self._pad.quit()
            self._pad = None

    def read(self) -> Command:
        """Sticks and buttons now; buttons speak to the session when they go down."""
        import pygame

        if self._pad is None:
            raise RobotError("the gamepad is not connected", where="gamepad", mend="call connect() before read()")
        pygame.event.clear()  # also takes in what the system reports; unread events would pile up
        if not self._pad.attached():
            raise RobotError("the gamepad is gone", where="gamepad",
                             mend="the attempt was kept; plug it in and start again: hardcase teleop --teleop gamepad")
        axes = tuple(float(self._pad.get_axis(k)) / FULL for k in range(len(AXES)))
        down = frozenset(name for k, name in enumerate(BUTTONS) if self._pad.get_button(k))
        new, self._held = down - self._held, down
        return command(axes, down, new)


def command(axes: tuple[float, ...], down: frozenset[str], new: frozenset[str]) -> Command:
    """What sticks and buttons mean.

    Args:
        axes: values in [-1, 1] in the order of AXES; y grows downwards, triggers lie in [0, 1].
        down: buttons held now.
        new: those of them that were not held at the tick before.
    """
    left_x, left_y, right_x, right_y, close, opens = (past_deadzone(a) for a in axes)
    spare = (float("up" in down) - float("down" in down), float("left" in down) - float("right" in down))
    motion = (-left_y, -left_x, -right_y, -right_x, *spare)
    return Command(axes=tuple(m + 0.0 for m in motion), grip=opens - close,
                   calls=frozenset(CALLS[name] for name in new if name in CALLS), raw_axes=axes,
                   raw_buttons=tuple(int(name in down) for name in BUTTONS))


def past_deadzone(value: float) -> float:
    """A share of travel with the dead zone cut out and the rest stretched, so that motion begins from nothing."""
    beyond = max(0.0, abs(value) - DEADZONE) / (1 - DEADZONE)
    return min(beyond, 1.0) * (1 if value > 0 else -1)
