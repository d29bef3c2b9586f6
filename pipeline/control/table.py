"""The parts by name, and a hierarchy of those that a config names."""

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

from pipeline.control.arm import ArmPlant, ArmSensed
from pipeline.control.arm_model import ArmModel
from pipeline.control.arm_parts import Ik, StraightPath, Target, Trimmed
from pipeline.control.config import HierarchyConfig
from pipeline.control.hierarchy import Hierarchy
from pipeline.control.legged import LeggedPlant, LeggedSensed
from pipeline.control.legged_model import LeggedModel
from pipeline.control.legged_parts import Profile, Trained, Waypoints
from pipeline.control.parts import Lower, Upper, Zero
from pipeline.control.sampling import Mpc
from pipeline.errors import ConfigError, unknown

type ArmUpper = Callable[[HierarchyConfig, ArmPlant], Upper[ArmSensed]]
type ArmLower = Callable[[HierarchyConfig, ArmPlant], Lower[ArmSensed]]
type LeggedUpper = Callable[[HierarchyConfig, LeggedPlant], Upper[LeggedSensed]]
type LeggedLower = Callable[[HierarchyConfig, LeggedPlant], Lower[LeggedSensed]]


def _arm_mpc(config: HierarchyConfig, plant: ArmPlant) -> Lower[ArmSensed]:
    model = ArmModel(plant.setup.body, plant.n, config.sampling, threads=plant.threads)
    return Mpc(config.sampling, model, plant.rest(), lower_hz=config.lower_hz, seed=config.seed)


def _legged_mpc(config: HierarchyConfig, plant: LeggedPlant) -> Lower[LeggedSensed]:
    model = LeggedModel(plant, config.sampling, threads=plant.threads)
    return Mpc(config.sampling, model, plant.rest(), lower_hz=config.lower_hz, seed=config.seed)


def _trained(config: HierarchyConfig, plant: LeggedPlant) -> Lower[LeggedSensed]:
    if config.policy is None:
        raise ConfigError("the lower `policy` needs a policy", where="policy",
                          mend="name an ONNX file; hardcase rl train --body biped --task walk makes one")
    return Trained(Path(config.policy), plant)


ARM_UPPERS: MappingProxyType[str, ArmUpper] = MappingProxyType({
    "target": lambda config, plant: Target(plant.goals),
    "path": lambda config, plant: StraightPath(plant.goals),
})
ARM_LOWERS: MappingProxyType[str, ArmLower] = MappingProxyType({
    "ik": lambda config, plant: Ik(plant, config.ik, lower_hz=config.lower_hz),
    "mpc": _arm_mpc,
    "zero": lambda config, plant: Zero(plant.rest()),
})
LEGGED_UPPERS: MappingProxyType[str, LeggedUpper] = MappingProxyType({
    "profile": lambda config, plant: Profile(config.course),
    "waypoints": lambda config, plant: Waypoints(config.course, plant.n, turns=True),
    "sidle": lambda config, plant: Waypoints(config.course, plant.n, turns=False),
})
LEGGED_LOWERS: MappingProxyType[str, LeggedLower] = MappingProxyType({
    "policy": _trained,
    "mpc": _legged_mpc,
    "zero": lambda config, plant: Zero(plant.rest()),
})
"""Name -> how a part is built for a plant. Add one: a class with the methods of Upper or Lower, and an entry here."""


def arm_hierarchy(config: HierarchyConfig, plant: ArmPlant) -> Hierarchy[ArmSensed]:
    """The hierarchy of arms that a config names; ConfigError lists the valid names."""
    upper = _entry("upper", config.upper, ARM_UPPERS)(config, plant)
    lower = _entry("lower", config.lower, ARM_LOWERS)(config, plant)
    if config.integral_1_s:
        lower = Trimmed(lower, plant.n, config.integral_1_s, lower_hz=config.lower_hz)
    return Hierarchy(plant, upper, lower, upper_hz=config.upper_hz, lower_hz=config.lower_hz)


def legged_hierarchy(config: HierarchyConfig, plant: LeggedPlant) -> Hierarchy[LeggedSensed]:
    """The hierarchy of legged robots that a config names; ConfigError lists the valid names."""
    upper = _entry("upper", config.upper, LEGGED_UPPERS)(config, plant)
    lower = _entry("lower", config.lower, LEGGED_LOWERS)(config, plant)
    return Hierarchy(plant, upper, lower, upper_hz=config.upper_hz, lower_hz=config.lower_hz)


def _entry[T](kind: str, name: str, table: MappingProxyType[str, T]) -> T:
    if name not in table:
        raise unknown(kind, name, table)
    return table[name]
