"""A keyboard as a terminal reports it: presses and repeats, no releases, bytes that come in pieces."""

import os
import pty
import termios

import pytest

from pipeline.errors import RobotError
from pipeline.robots.keyboard import BUTTONS, GRIP_TICKS, HOLD_TICKS, Keyboard


@pytest.fixture
def typed():
    """A connected keyboard, and what types on it."""
    master, slave = pty.openpty()
    keyboard = Keyboard(slave)
    keyboard.connect()

    def press(text: str):
        os.write(master, text.encode())
        return keyboard.read()

    yield keyboard, press
    keyboard.disconnect()
    os.close(master)
    os.close(slave)


def test_a_tap_is_a_short_step_and_repeats_go_on_without_a_break(typed):
    keyboard, press = typed
    assert press("w").axes[0] == 1.0
    rest = [keyboard.read().axes[0] for _ in range(HOLD_TICKS + 1)]
    assert rest == [1.0] * (HOLD_TICKS - 1) + [0.0, 0.0]
    assert all(press("s").axes[0] == -1.0 for _ in range(20))


@pytest.mark.parametrize(("keys", "axes"), [
    ("wa", (1, 1, 0, 0)), ("W", (0.25, 0, 0, 0)), ("fe", (0, 0, -1, -1)), ("\x1b[A", (1, 0, 0, 0)),
    ("\x1bOD", (0, 1, 0, 0)), ("\x1b[1;2B", (-0.25, 0, 0, 0)), ("\x1b[5~w", (1, 0, 0, 0)), ("sw", (1, 0, 0, 0)),
    ("\x1b\x1b[A", (1, 0, 0, 0)), ("é?\x00z", (0, 0, 0, 0)),
], ids=["two keys", "capital", "down and turn", "arrow", "arrow of another terminal", "shift and arrow",
        "a key without a meaning before one that has", "the later one counts", "escape alone", "nonsense"])
def test_keys_move_the_axes_that_the_manual_says(typed, keys, axes):
    assert typed[1](keys).axes[:4] == axes


def test_an_arrow_that_comes_in_two_pieces_is_one_arrow(typed):
    _, press = typed
    assert press("\x1b[").axes[:2] == (0, 0)
    assert press("C").axes[:2] == (0, -1)


def test_the_space_bar_closes_an_open_gripper_and_opens_a_closed_one(typed):
    keyboard, press = typed
    closing = [press(" ").grip, *(keyboard.read().grip for _ in range(GRIP_TICKS))]
    assert closing == [-1.0] * GRIP_TICKS + [0.0]
    assert press(" ").grip == 1.0 and press("c").grip == -1.0
    assert press("c").raw_buttons[BUTTONS.index("c")] == 1


def test_keys_speak_to_the_session_once(typed):
    keyboard, press = typed
    assert press("ty").calls == {"take-over", "success"}
    assert keyboard.read().calls == set()
    assert press("wc").axes[0] == 1.0
    assert press("\r").calls == {"next"} and keyboard.read().axes[0] == 0.0, "an attempt begins with everything still"
    assert press(" ").grip == -1.0, "and with an open gripper"
    assert press("nux").calls == {"failure", "unknown", "quit"}


def test_the_terminal_is_given_back_as_it_was():
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    keyboard = Keyboard(slave)
    keyboard.connect()
    assert termios.tcgetattr(slave) != before
    keyboard.disconnect()
    keyboard.disconnect()
    assert termios.tcgetattr(slave) == before
    with pytest.raises(RobotError, match="the keyboard is not connected"):
        keyboard.read()
    os.close(master)
    os.close(slave)
