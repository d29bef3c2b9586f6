"""A LeRobot plugin package with two input devices: a leader arm of any joints, and a pad with events."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.teleoperators.utils import TeleopEvents


@TeleoperatorConfig.register_subclass("virtual_leader")
@dataclass
class VirtualLeaderConfig(TeleoperatorConfig):
    hand: str


@TeleoperatorConfig.register_subclass("virtual_pad")
@dataclass
class VirtualPadConfig(TeleoperatorConfig):
    hand: str


class _Hand(Teleoperator):
    """Moved by rows in a file, one a reading; the last row stays."""

    def __init__(self, config):
        super().__init__(config)
        self.rows = json.loads(Path(config.hand).read_text())
        self.at, self._connected = 0, False

    @property
    def feedback_features(self):
        return {}

    @property
    def is_connected(self):
        return self._connected

    @property
    def is_calibrated(self):
        return True

    def calibrate(self):
        pass

    def configure(self):
        pass

    def send_feedback(self, feedback):
        pass

    def connect(self, calibrate=True):
        self._connected = True

    def disconnect(self):
        self._connected = False

    def row(self):
        return self.rows[min(self.at, len(self.rows) - 1)]


class VirtualLeader(_Hand):
    """Joint targets; which joints, the file says."""

    config_class, name = VirtualLeaderConfig, "virtual_leader"

    @cached_property
    def action_features(self):
        return {f"{name}.pos": float for name in self.rows[0]}

    def get_action(self):
        found = {f"{name}.pos": value for name, value in self.row().items()}
        self.at += 1
        return found


class VirtualPad(_Hand):
    """Shares of full speed, and lerobot's events."""

    config_class, name = VirtualPadConfig, "virtual_pad"

    @property
    def action_features(self):
        return {"dtype": "float32", "shape": (4,), "names": {"delta_x": 0, "delta_y": 1, "delta_z": 2, "gripper": 3}}

    def get_action(self):
        found = {name: self.row().get(name, 1.0 if name == "gripper" else 0.0)
                 for name in ("delta_x", "delta_y", "delta_z", "gripper")}
        self.at += 1
        return {name: float("nan") if value is None else value for name, value in found.items()}

    def get_teleop_events(self):
        now = self.rows[min(self.at, len(self.rows)) - 1] if self.at else {}
        return {event: bool(now.get(event.value)) for event in TeleopEvents}
