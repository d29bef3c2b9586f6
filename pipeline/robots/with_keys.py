"""WithKeys: a device for the robot, and the terminal's keys for the session."""

from dataclasses import replace

from pipeline.protocols import Command, Teleoperator
from pipeline.robots.keyboard import Keyboard


class WithKeys:
    """Implements pipeline.protocols.Teleoperator: a leader arm has no key that says 'success'.

    Args:
        device: moves the robot.
        keys: speaks to the session; its motion keys do nothing.
    """

    def __init__(self, device: Teleoperator, keys: Keyboard) -> None:
        self._device, self._keys = device, keys
        self.name, self.joints = device.name, device.joints
        axes, buttons = device.raw_names
        self.raw_names = (axes, (*buttons, *keys.raw_names[1]))

    def connect(self) -> None:
        """Open both; the device first, for its calibration may ask questions on the terminal."""
        self._device.connect()
        self._keys.connect()

    def read(self) -> Command:
        """The device's command, with what both say to the session."""
        command, keys = self._device.read(), self._keys.read()
        return replace(command, calls=command.calls | keys.calls, raw_buttons=(*command.raw_buttons, *keys.raw_buttons))

    def disconnect(self) -> None:
        """Give both back."""
        try:
            self._keys.disconnect()
        finally:
            self._device.disconnect()
