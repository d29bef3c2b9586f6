"""A LeRobot plugin package with three robots: the reference arm in its own physics engine, a small one, a rover.

LeRobot finds it as it finds every plugin: by the name of its distribution.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import mujoco
import numpy as np
from lerobot.robots import Robot, RobotConfig

from pipeline.frames import ENVIRONMENT, JOINTS
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.tasks import sample_scene, scene_seed
from pipeline.simulation.world import World

SIX = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@RobotConfig.register_subclass("virtual_arm")
@dataclass
class VirtualArmConfig(RobotConfig):
    attempt: int = 0
    sees: bool = True
    cable_off_at: int = -1


@RobotConfig.register_subclass("virtual_six")
@dataclass
class VirtualSixConfig(RobotConfig):
    port: str
    picture: bool = False
    broken_encoder_at: int = -1


@RobotConfig.register_subclass("virtual_rover")
@dataclass
class VirtualRoverConfig(RobotConfig):
    pass


class _Plugged(Robot):
    """What all have in common: nothing to calibrate."""

    def __init__(self, config):
        super().__init__(config)
        self.config, self.ticks, self._connected = config, 0, False

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

    def connect(self, calibrate=True):
        self._connected = True

    def disconnect(self):
        self._connected = False


class VirtualArm(_Plugged):
    """Takes joint targets, runs them for one control period, and has a camera that finds the cube."""

    config_class, name = VirtualArmConfig, "virtual_arm"

    @cached_property
    def action_features(self):
        return {f"{name}.pos": float for name in (*JOINTS, "gripper")}

    @cached_property
    def observation_features(self):
        return {**self.action_features, **(dict.fromkeys(ENVIRONMENT, float) if self.config.sees else {})}

    def connect(self, calibrate=True):
        scene = sample_scene("pick-place", "teleop", scene_seed("teleop", 7, self.config.attempt), "common")
        setup = compose(load_body("arm"), "table")
        world = World(setup, [scene], from_draws([()]), threads=1)
        self.model, self.data = setup.model, mujoco.MjData(setup.model)
        mujoco.mj_setState(self.model, self.data, world.batch.state[0].copy(), mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)
        self.target = (*scene.target_xy_m, 0.0)
        super().connect(calibrate)

    def get_observation(self):
        found = {f"{name}.pos": self.data.joint(name).qpos[0] for name in JOINTS}
        found["gripper.pos"] = sum(self.data.joint(f"{side}_slide").qpos[0] for side in ("left", "right"))
        if self.config.sees:
            x, y, z, w, a, b, c = self.data.joint("object").qpos
            yaw = np.arctan2(2 * (w * c + a * b), 1 - 2 * (b * b + c * c))
            yaw = (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
            found |= dict(zip(ENVIRONMENT, (x, y, z, yaw, *self.target), strict=True))
        return found

    def send_action(self, action):
        self.ticks += 1
        if self.ticks == self.config.cable_off_at:
            raise ConnectionError("Failed to write 'Goal_Position': no status packet")
        self.data.ctrl[:6] = [action[f"{name}.pos"] for name in JOINTS]
        self.data.ctrl[6] = action["gripper.pos"] / 2
        mujoco.mj_step(self.model, self.data, round(0.05 / self.model.opt.timestep))
        return action


class VirtualSix(_Plugged):
    """Five joints and a gripper in degrees and percent, as the SO-101 counts; each goes half the way a tick."""

    config_class, name = VirtualSixConfig, "virtual_six"

    def __init__(self, config):
        super().__init__(config)
        self.position = dict.fromkeys(self.action_features, 10.0)

    @cached_property
    def action_features(self):
        return {f"{name}.pos": float for name in SIX}

    @cached_property
    def observation_features(self):
        return {**self.action_features, **({"wrist": (48, 64, 3)} if self.config.picture else {})}

    def get_observation(self):
        found = dict(self.position)
        if self.ticks == self.config.broken_encoder_at:
            found["elbow_flex.pos"] = float("nan")
        if self.config.picture:
            found["wrist"] = np.full((48, 64, 3), self.ticks % 256, np.uint8)
        return found

    def send_action(self, action):
        self.ticks += 1
        for name, target in action.items():
            assert np.isfinite(target), "a NaN reached the motors"
            self.position[name] += 0.5 * (target - self.position[name])
        return action


class VirtualRover(_Plugged):
    """Takes speeds, which it does not measure, and tells its battery."""

    config_class, name = VirtualRoverConfig, "virtual_rover"
    action_features: ClassVar = {"linear_velocity": float, "angular_velocity": float}
    observation_features: ClassVar = {"battery_percent": float}

    def get_observation(self):
        return {"battery_percent": 100.0 - self.ticks}

    def send_action(self, action):
        self.ticks += 1
        return action
