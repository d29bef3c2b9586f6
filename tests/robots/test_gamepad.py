"""A gamepad that SDL believes in: a virtual one, attached to the SDL that pygame brings."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from flows.teleop.devices import TeleopOrder, open_device
from pipeline.errors import RobotError
from pipeline.recording import read_episode
from pipeline.robots.gamepad import AXES, BUTTONS, Gamepad
from pipeline.robots.mapping import ArmDriver
from pipeline.robots.session import Controls, Session
from pipeline.robots.simulated import ARM_LIMITS
from stages.teleop import teleop

GAME_CONTROLLER = 1  # SDL_JOYSTICK_TYPE_GAMECONTROLLER


class VirtualPad:
    """SDL's own virtual joystick, by SDL_JoystickAttachVirtual of SDL 2.0.14 and later."""

    def __init__(self, sdl: ctypes.CDLL) -> None:
        self._sdl = sdl
        self.index = sdl.SDL_JoystickAttachVirtual(GAME_CONTROLLER, len(AXES), len(BUTTONS), 0)
        assert self.index >= 0
        sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
        self._stick = ctypes.c_void_p(sdl.SDL_JoystickOpen(self.index))

    def push(self, axis: str, share: float) -> None:
        value = ctypes.c_int16(round(share * 32767))
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._stick, AXES.index(axis), value) == 0

    def hold(self, button: str, down: bool = True) -> None:
        assert self._sdl.SDL_JoystickSetVirtualButton(self._stick, BUTTONS.index(button), ctypes.c_uint8(down)) == 0

    def unplug(self) -> None:
        self._sdl.SDL_JoystickDetachVirtual(self.index)


@pytest.fixture
def sdl(monkeypatch):
    """The SDL that pygame has loaded, its joysticks ready."""
    pytest.importorskip("pygame")
    with pytest.raises(RobotError):  # brings SDL up; nothing is plugged in
        Gamepad(index=7).connect()
    (path,) = {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libSDL2-2" in line}
    return ctypes.CDLL(path)


@pytest.fixture
def pad(sdl):
    _forget_events(sdl)  # pygame fails on events of a pad that an earlier test took away
    plugged = VirtualPad(sdl)
    yield plugged
    plugged.unplug()
    _forget_events(sdl)


def _forget_events(sdl):
    sdl.SDL_PumpEvents()
    sdl.SDL_FlushEvents(0, 0xFFFF)


def test_sticks_triggers_and_buttons_mean_what_the_manual_says(pad):
    gamepad = Gamepad(pad.index)
    gamepad.connect()
    pad.push("left_y", -1.0)
    pad.push("left_x", 0.05)
    pad.push("right_y", 0.56)
    pad.push("trigger_right", 1.0)
    pad.hold("right_shoulder")
    pad.hold("up")
    said = gamepad.read()
    x, y, z, yaw, joint5, joint6 = said.axes
    assert (x, y, yaw, joint5, joint6) == (1.0, 0.0, 0.0, 1.0, 0.0), "a stick within the dead zone does nothing"
    assert z == pytest.approx(-0.5, abs=0.001) and said.grip == pytest.approx(1.0)
    assert said.calls == {"take-over"} and said.raw_buttons[BUTTONS.index("up")] == 1
    assert said.raw_axes[AXES.index("left_x")] == pytest.approx(0.05, abs=0.001), "raw values are recorded as they are"
    assert gamepad.read().calls == set(), "a button that stays down speaks once"
    gamepad.disconnect()


def test_a_gamepad_drives_the_robot_and_ends_attempts(pad, simulated, tmp_path):
    robot, scene_of = simulated()

    def person(status):
        tick = round(status.seconds * robot.control_hz)
        pad.hold("start", status.who == "reset" and tick >= 1)
        pad.push("left_y", -1.0 if status.who == "operator" and tick < 10 else 0.0)
        pad.hold("y", status.who == "operator" and tick >= 15)

    gamepad = Gamepad(pad.index)
    gamepad.connect()
    session = Session("p7", "none", tmp_path, {}, {}, 0, episodes=2, show=person)
    controls = Controls(gamepad, ArmDriver(robot.control_hz, robot.pose_of), ARM_LIMITS)
    first, second = teleop(robot, controls, scene_of, session)
    gamepad.disconnect()
    for closed in (first, second):
        _, trace = read_episode(closed.path)
        assert closed.episode.outcome.label == "success" and closed.episode.outcome.judged_by == "operator"
        assert trace.action[:, 0].sum() == pytest.approx(10 * 0.12 / 20, rel=0.15)
        assert np.ptp(trace.state[:, 7]) > 0.03, "the hand moved forward"


def test_a_gamepad_that_is_unplugged_ends_the_attempt_which_is_kept(pad, simulated, tmp_path):
    robot, scene_of = simulated()

    def person(status):
        pad.hold("start", status.who == "reset")
        if status.who == "operator" and status.seconds > 0.5:
            pad.unplug()

    gamepad = Gamepad(pad.index)
    gamepad.connect()
    session = Session("p7", "none", tmp_path, {}, {}, 0, episodes=2, show=person)
    controls = Controls(gamepad, ArmDriver(robot.control_hz, robot.pose_of), ARM_LIMITS)
    attempts = teleop(robot, controls, scene_of, session)
    closed = next(attempts)
    with pytest.raises(RobotError, match=r"the gamepad is gone[\s\S]*plug it in"):
        next(attempts)
    assert closed.episode.outcome.reason == "cut off: the gamepad is gone" and closed.episode.frames == 11
    assert read_episode(closed.path)[0] == closed.episode


def test_lerobots_own_gamepad_teleoperator_drives_and_takes_over(pad, tmp_path):
    order = TeleopOrder(teleop="lerobot:gamepad", teleop_keys={"calibration_dir": str(tmp_path)})
    device = open_device(order)
    device.connect()
    pad.push("left_y", -1.0)  # lerobot reads the raw joystick: axis 1 forward, button 5 intervenes, 3 is success
    device.read()
    said = device.read()
    assert said.axes == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-4) and said.grip == 0.0
    assert said.intervening is False and said.calls == set()
    pad.hold(BUTTONS[5])
    pad.hold(BUTTONS[3])
    said = device.read()
    assert said.intervening is True and said.calls == {"success"}
    assert device.read().calls == set()
    device.disconnect()
    with pytest.raises(RobotError, match=r"lerobot:gamepad does not answer"):
        device.read()


def test_without_a_gamepad_the_error_says_how_many_devices_there_are(sdl):
    with pytest.raises(RobotError, match=r"no gamepad 3; 0 devices are connected[\s\S]*usermod -aG input"):
        Gamepad(3).connect()
