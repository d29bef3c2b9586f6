"""`hardcase teleop`: parses, calls, sets the exit code; the work is flows/teleop/teleoperation.py's."""

from collections.abc import Sequence
from typing import Annotated

import typer

from pipeline.errors import ConfigError

INTERRUPTED = 130
Keys = Annotated[list[str] | None, typer.Option(help="KEY=VALUE of its LeRobot config; may be given again.")]


def teleop(
    robot: Annotated[str, typer.Option(help="arm (simulated), twin:SEED, or lerobot:NAME.")] = "arm",
    teleop: Annotated[str, typer.Option(help="keyboard, gamepad, or lerobot:NAME.")] = "keyboard",
    policy: Annotated[
        str | None, typer.Option(help="Begin with a policy, to be taken over from: an id, champion, or expert.")
    ] = None,
    shadow: Annotated[
        list[str] | None, typer.Option(help="Policy that watches and cannot act: its id; may be given again.")
    ] = None,
    operator: Annotated[str, typer.Option(help="Pseudonym of the person; never a name.")] = "anonymous",
    consent: Annotated[
        str | None, typer.Option(help="Id of the person's consent; without one nothing is learnt from it.")
    ] = None,
    task: Annotated[str, typer.Option(help="What is to be done.")] = "pick-place",
    stratum: Annotated[str | None, typer.Option(help="Kind of start, simulated robots only. [default: common]")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="How many attempts.")] = 1,
    max_s: Annotated[float, typer.Option(min=1, help="Longest attempt, in seconds.")] = 120.0,
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera of the scene to record: front, top; may be given again.")
    ] = None,
    size: Annotated[str, typer.Option(help="Width and height of pictures.")] = "320x240",
    by_key: Annotated[bool, typer.Option("--by-key", help="Only the person ends an attempt, no predicate.")] = False,
    stop_on_trigger: Annotated[
        bool, typer.Option("--stop-on-trigger", help="A trigger while the policy drives ends the attempt as a failure.")
    ] = False,
    ring: Annotated[
        bool, typer.Option("--ring", help="Every tick only 10 s before and 5 s after a trigger, and while you command.")
    ] = False,
    hand_speed: Annotated[float, typer.Option(min=0.1, max=3, help="Factor on the speed of keys and sticks.")] = 1.0,
    speed: Annotated[float, typer.Option(min=0, help="Simulated seconds a second; 0: as fast as it goes.")] = 1.0,
    hz: Annotated[float, typer.Option(min=1, max=200, help="Control rate of LeRobot robots.")] = 20.0,
    max_step: Annotated[
        list[str] | None,
        typer.Option(help="How far a joint of a LeRobot robot may move a tick, in its own unit: 2, or NAME=2."),
    ] = None,
    robot_key: Keys = None,
    teleop_key: Keys = None,
    plugin: Annotated[list[str] | None, typer.Option(help="Module that registers LeRobot devices.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """Drive a robot, or take over from a policy; every attempt is recorded whole and kept in the store.

    Keys and buttons: docs/teleoperation.md, or look below the command once it runs.

    Example: hardcase teleop --operator p7 --consent form-12 --policy champion --episodes 5
    """
    from flows.teleop.devices import TeleopOrder
    from flows.teleop.teleoperation import run_teleop
    from pipeline.store import store_root

    order = TeleopOrder(
        robot=robot, robot_keys=_pairs(robot_key, "--robot-key"), teleop=teleop,
        teleop_keys=_pairs(teleop_key, "--teleop-key"), plugins=tuple(plugin or ()), policy=policy,
        shadows=tuple(shadow or ()), task=task, stratum=stratum, operator=operator, consent=consent,
        episodes=episodes, cameras=tuple(camera or ()), size=picture_size(size), hz=hz, speed=speed,
        hand_speed=hand_speed, max_step=_steps(max_step), max_s=max_s,
        by_key=by_key, stop_on_trigger=stop_on_trigger, ring=ring)
    if run_teleop(order, store_root(), as_json=json):
        raise typer.Exit(INTERRUPTED)


def _pairs(texts: Sequence[str] | None, option: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts or ():
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ConfigError(f"{text!r} is not KEY=VALUE", where=option, mend=f"{option} port=/dev/ttyACM0")
        found[key] = value
    return found


def _steps(texts: Sequence[str] | None) -> dict[str, float]:
    """Feature -> largest step; "" stands for all others."""
    found: dict[str, float] = {}
    for text in texts or ():
        name, _, value = text.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ConfigError(f"{value!r} is no number", where=f"--max-step {text}",
                              mend="--max-step 2, or --max-step shoulder_pan.pos=2") from None
    return found


def picture_size(text: str) -> tuple[int, int]:
    """Width and height from WIDTHxHEIGHT; ConfigError on anything else."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 640 and 16 <= int(height) <= 480):
        raise ConfigError(f"{text!r} is no size of a picture", where="--size", mend="--size 320x240, 640x480 at most")
    return int(width), int(height)
