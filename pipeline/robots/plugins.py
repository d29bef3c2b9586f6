"""LeRobot's registries of robots and teleoperators: look a name up, fill its config, make the device.

Names come from lerobot itself, from installed packages called lerobot_robot_* and lerobot_teleoperator_*, and from
modules that the person names; all of them register themselves by lerobot's `register_subclass`.
"""

# lerobot and draccus are partly untyped
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false

import importlib
import logging
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, Literal

import yaml

from pipeline.errors import ConfigError, RobotError, one_line

if TYPE_CHECKING:
    from lerobot.robots import Robot
    from lerobot.teleoperators import Teleoperator

type Kind = Literal["robot", "teleop"]

PACKAGES: Mapping[Kind, str] = {"robot": "lerobot.robots", "teleop": "lerobot.teleoperators"}


def make_robot(name: str, keys: Mapping[str, str], plugins: Sequence[str] = ()) -> "Robot":
    """The lerobot robot registered as `name`, not yet connected.

    Args:
        name: as in lerobot's `--robot.type`.
        keys: config key -> value as YAML; a dotted key reaches into a nested config.
        plugins: further modules to import first, as lerobot's `discover_packages_path`.

    Raises:
        ConfigError: unknown name, plugin, key or value.
        RobotError: the device's driver is not installed, or refuses the config.
    """
    from lerobot.robots import make_robot_from_config

    return _made("robot", name, make_robot_from_config, keys, plugins)


def make_teleoperator(name: str, keys: Mapping[str, str], plugins: Sequence[str] = ()) -> "Teleoperator":
    """The lerobot teleoperator registered as `name`, not yet connected; see make_robot."""
    from lerobot.teleoperators import make_teleoperator_from_config

    return _made("teleop", name, make_teleoperator_from_config, keys, plugins)


def known(kind: Kind, plugins: Sequence[str] = ()) -> dict[str, type]:
    """Registered name -> config class, of everything that can be imported here."""
    from lerobot.configs.parser import PluginLoadError
    from lerobot.robots import RobotConfig
    from lerobot.teleoperators import TeleoperatorConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    for plugin in plugins:
        try:
            _load(plugin)
        except (PluginLoadError, ImportError) as error:
            raise ConfigError(f"plugin {plugin!r} does not load: {one_line(error)}", where=f"--plugin {plugin}",
                              mend="install it, or put its folder on PYTHONPATH") from error
    package = importlib.import_module(PACKAGES[kind])
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        if module.ispkg:
            try:
                importlib.import_module(module.name)
            except ImportError as error:  # a robot whose vendor's package is not installed: the others remain
                logging.getLogger(__name__).info("%s does not load: %s", module.name, one_line(error))
    registry: Any = RobotConfig if kind == "robot" else TeleoperatorConfig
    return dict(registry.get_known_choices())


def _load(plugin: str) -> None:
    from lerobot.configs.parser import load_plugin

    if hasattr(importlib.import_module(plugin), "__path__"):
        load_plugin(plugin)  # a package: lerobot also imports everything directly inside


def _made[T](kind: Kind, name: str, make: Callable[[Any], T], keys: Mapping[str, str], plugins: Sequence[str]) -> T:
    where = f"--{kind} lerobot:{name}"
    choices = known(kind, plugins)
    if name not in choices:
        raise ConfigError(f"lerobot knows no {_words(kind)} {name!r}", where=where,
                          mend=f"install its plugin, lerobot_{_words(kind)}_*, or use: {', '.join(sorted(choices))}")
    config = _config(choices[name], keys, kind, name)
    try:
        return make(config)
    except Exception as error:  # drivers raise what they like, and lerobot wraps some of it
        missing = error if isinstance(error, ImportError) else error.__cause__
        if isinstance(missing, ImportError):
            raise RobotError(one_line(missing), where=where, mend="install the driver that it names") from error
        raise RobotError(f"lerobot does not make {name!r}: {one_line(error)}", where=where,
                         mend=f"look at its config keys: {', '.join(_keys(choices[name]))}") from error


def _config(choice: type, keys: Mapping[str, str], kind: Kind, name: str) -> Any:
    import draccus

    raw: dict[str, Any] = {}
    for key, text in keys.items():
        place, *_, last = raw, *key.split(".")
        for part in key.split(".")[:-1]:
            place = place.setdefault(part, {})
        place[last] = yaml.safe_load(text)
    missing = [f.name for f in fields(choice) if f.init and f.default is MISSING and f.default_factory is MISSING
               and f.name not in raw]
    where = f"--{kind} lerobot:{name}"
    if missing:
        raise ConfigError(f"{name!r} needs {', '.join(missing)}", where=where,
                          mend=" ".join(f"--{kind}-key {key}=VALUE" for key in missing))
    if unknown := sorted(set(raw) - set(_keys(choice))):
        raise ConfigError(f"{name!r} has no key {', '.join(unknown)}", where=where,
                          mend=f"use: {', '.join(_keys(choice))}")
    try:
        return draccus.decode(choice, raw)
    except Exception as error:  # draccus raises several types of its own
        raise ConfigError(f"{name!r} refuses its config: {one_line(error)}", where=where,
                          mend=f"give values as YAML: --{kind}-key KEY=VALUE") from error


def _keys(choice: type) -> list[str]:
    return [f.name for f in fields(choice) if f.init]


def _words(kind: Kind) -> str:
    return "robot" if kind == "robot" else "teleoperator"
