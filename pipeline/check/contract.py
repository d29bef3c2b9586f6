"""Contracts: read from YAML, completed by what the data says of itself."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from pipeline.check.motion import unit_of
from pipeline.check.signals import Signals, Subject, Tables
from pipeline.documents import load_document
from pipeline.frames import ENVIRONMENT, FEATURES, STATE
from pipeline.recording.dialect import FRAME_TOPICS, LEGGED_TOPICS, topic_type
from pipeline.simulation.tasks import TASKS
from schemas.contract import Contract, Evaluation, Limit, Pair, Success, TopicRule

EXAMPLE = "see docs/check.md, or write one from a good log: hardcase check LOG --init"
LEGGED_ACTION = "/command/joints"
"""Topic that legged robots alone have. Legs bear a load: their joints need not go where their servos are told, and
targets may lie beyond a stop, for that is how a servo of limited stiffness is asked for force."""
STEPS = {"ee_x": "dx", "ee_y": "dy", "ee_z": "dz", "ee_yaw": "dyaw"}
SUMS = {"cmd_x": "dx", "cmd_y": "dy", "cmd_z": "dz", "cmd_yaw": "dyaw"}
"""What our commanded pose is the sum of; each step counts from the next row on."""
NEXT_ROW_S = (0.0, 0.1)
""""From the next row on", at 20 Hz and with room for a live clock [s]."""
PAIRS = (
    Pair(measured="/joint_states.position", commanded="/joint_commands.position"),
    Pair(measured="/ee/measured.data", commanded="/command/ee.data", kind="step", columns=STEPS),
    Pair(measured="/ee/commanded.data", commanded="/command/ee.data", kind="step", columns=SUMS, lag_s=NEXT_ROW_S),
    Pair(measured="observation.state", commanded="action.joint"),
    Pair(measured="observation.state", commanded="action", kind="step", columns=STEPS),
    Pair(measured="observation.state", commanded="action", kind="step", columns=SUMS, lag_s=NEXT_ROW_S),
    Pair(measured="observation.state", commanded="action"),
)
"""What follows what, in our recordings and versions and in any dataset whose state and action share names."""
KNOWN = frozenset((*STATE, *ENVIRONMENT))
"""Columns whose unit is known by their name, wherever they are recorded."""
MAX_URDF = 4 << 20
URDF_SPEEDLESS = 1e5
"""Velocity limits from here on stand for none [rad/s, m/s]; see pipeline.simulation.urdf.UNLIMITED."""


def load_contract(file: Path) -> Contract:
    """A contract from a YAML file.

    Raises:
        ConfigError: no such file, not YAML, or a value that breaks a rule.
    """
    return load_document(file, Contract, kind="a contract", example=EXAMPLE)


def completed(contract: Contract, subject: Subject) -> Contract:
    """The contract with what the data says of itself, wherever the contract says nothing."""
    if not subject.recordings:
        return contract
    first = subject.recordings[0]
    found: dict[str, Any] = {}
    if not contract.motion:
        found["motion"] = _pairs(first)
    if not contract.topics and first.episode is not None:
        found["topics"] = _dialect(first.episode.control_hz, first)
    if not contract.limits:
        found["limits"] = _limits(first)
    if contract.success is None and (success := _success(subject)) is not None:
        found["success"] = success
    if contract.evaluation is None and (evaluation := _evaluation(subject)) is not None:
        found["evaluation"] = evaluation
    return contract.model_copy(update=found)


def _pairs(signals: Signals) -> tuple[Pair, ...]:
    """Those of PAIRS that this recording has; a dataset's joint targets, if it has them, instead of its action."""
    if LEGGED_ACTION in signals.topics:
        return ()
    there = [p for p in PAIRS if (own := signals.find(p.measured)) and (found := signals.find(p.commanded))
             and {*p.columns} <= {*own[2].names} and {*p.columns.values()} <= {*found[2].names}]
    return tuple(p for p in there if p.columns or p.commanded != "action" or len(there) == 1)


def _dialect(hz: float, signals: Signals) -> dict[str, TopicRule]:
    """What every recording of ours has; one of another robot has the joints alone."""
    names = FRAME_TOPICS if "/command/ee" in signals.topics else (
        LEGGED_TOPICS if LEGGED_ACTION in signals.topics else ("/joint_states", "/joint_commands"))
    return {name: TopicRule(type=topic_type(name), rate_hz=hz) for name in names}


def _limits(signals: Signals) -> dict[str, dict[str, Limit]]:
    """Joint limits out of an attached URDF, for the columns that are named as its joints; units where known."""
    joints = urdf_limits(signals.attachments.get("robot.urdf", b""))
    found: dict[str, dict[str, Limit]] = {}
    for reference, _, column in signals.numbers():
        if reference.endswith((".velocity", ".effort")):
            continue
        if reference == "/joint_commands.position" and LEGGED_ACTION in signals.topics:
            found[reference] = {n: Limit(unit="rad") for n in column.names}
        elif reference.endswith(("joint_states.position", "joint_commands.position")):
            found[reference] = {n: joints.get(n, Limit(unit=unit_of(n, Contract(), reference))) for n in column.names}
        elif reference != "action" and set(column.names) <= KNOWN:
            found[reference] = {n: Limit(unit="rad" if "joint" in n or "yaw" in n else "m") for n in column.names}
    return {reference: limits for reference, limits in found.items() if limits}


def urdf_limits(urdf: bytes) -> dict[str, Limit]:
    """Joint -> limits of a URDF; none where it is no URDF. Document types, which can blow up, are refused."""
    if not urdf or len(urdf) > MAX_URDF or b"<!DOCTYPE" in urdf or b"<!ENTITY" in urdf:
        return {}
    try:
        root = ET.fromstring(urdf)  # without a document type there is nothing to expand
    except (ET.ParseError, ValueError):
        return {}
    found: dict[str, Limit] = {}
    for joint in root.iter("joint"):
        kind, name, limit = joint.get("type"), joint.get("name"), joint.find("limit")
        if name and kind in ("revolute", "prismatic") and limit is not None:
            low, high, speed = (number(limit.get(k)) for k in ("lower", "upper", "velocity"))
            if low is not None and high is not None and low < high:
                found[name] = Limit(low=low, high=high, unit="rad" if kind == "revolute" else "m",
                                    speed=speed if speed is not None and 0 < speed < URDF_SPEEDLESS else None)
    return found


def number(text: str | None) -> float | None:
    """A finite number out of a text; None where it is none."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _success(subject: Subject) -> Success | None:
    """The predicate of the task that the data names."""
    first = subject.recordings[0]
    named = first.episode.scene.task if first.episode is not None else None
    if subject.tables is not None:
        named = _recipe(subject.tables).get("task")
    task = TASKS.get(str(named))
    return None if task is None else Success(within_m=task.within_m, away_m=task.hand_away_m, open_m=task.open_m,
                                             low_m=task.on_table_m, hold_ticks=task.hold_ticks)


def _recipe(tables: Tables) -> Mapping[str, Any]:
    """The recipe of one of our versions; nothing of one made from other robots' logs, whose task is its own."""
    return {} if "ingested" in tables.manifest else tables.manifest.get("recipe", {})


def _evaluation(subject: Subject) -> Evaluation | None:
    """The task that one of our versions was built for: that of its recipe, with the environment's features."""
    if subject.tables is None or (recipe := _recipe(subject.tables)).get("task") not in TASKS:
        return None
    reach = (0.02, 0.02, 0.02, 0.12)
    features = {name: FEATURES[name] for name in ("observation.state", "observation.environment_state", "action")}
    return Evaluation(robot=recipe.get("robot"), task=recipe.get("task"), control_hz=20.0, features=features,
                      action_low=(*(-x for x in reach), 0.0), action_high=(*reach, 0.08))
