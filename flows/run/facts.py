"""Facts about what runs: versions, commit, command line, hashes of the stages' sources."""

import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from pipeline.files import source_hash
from pipeline.store import RunInfo
from schemas.recipe import Recipe

PACKAGES = ("hardcase", "mujoco", "lerobot", "torch", "onnxruntime", "prefect", "mcap", "pyarrow", "numpy")
ROOT = Path(__file__).parents[2]

EVERY_RECORDING = (
    "pipeline/frames.py", "pipeline/trace.py",
    "pipeline/recording/assemble.py", "pipeline/recording/cdr.py", "pipeline/recording/columns.py",
    "pipeline/recording/dialect.py", "pipeline/recording/interleave.py", "pipeline/recording/metadata.py",
    "pipeline/recording/records.py", "pipeline/recording/write.py",
    "pipeline/simulation/bodies.py", "pipeline/simulation/kinematics.py", "pipeline/simulation/model.py",
    "pipeline/simulation/physics.py", "pipeline/simulation/recordings.py", "pipeline/simulation/rollout.py",
    "pipeline/simulation/scenes.py", "pipeline/simulation/tasks.py", "pipeline/simulation/tracing.py",
    "pipeline/simulation/urdf.py", "pipeline/simulation/world.py",
)
"""What decides the bytes of every simulated recording: what is simulated, what is kept of it, and how it is written.

Nothing else is in the list, because the hash of these files stands in the recording: its bytes, their hash and the ids
that follow from it change with any of them. Pictures, other environments and whatever reads recordings must not do
that. tests/flows/test_facts.py holds the list against the imports of the stages."""

RECORDINGS_OF: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "collect": ("stages/collect.py", "pipeline/simulation/expert.py"),
    "deploy": ("stages/deploy.py", "pipeline/triggers.py", "pipeline/twin/law.py", "pipeline/twin/twin.py",
               "pipeline/policies/ensembling.py", "pipeline/policies/onnx_policy.py", "pipeline/policies/runtime.py",
               "pipeline/disagreement.py", "pipeline/policies/features.py", "pipeline/shadow/candidate.py",
               "pipeline/shadow/limits.py", "pipeline/shadow/ridden.py", "pipeline/shadow/riders.py",
               "pipeline/shadow/sizes.py", "pipeline/shadow/targets.py", "pipeline/shadow/wire.py",
               "pipeline/signals/neighbours.py", "pipeline/signals/tick.py",
               "pipeline/signals/warning.py"),
    "harvest": ("stages/harvest.py", "pipeline/triggers.py", "pipeline/twin/law.py", "pipeline/twin/twin.py",
                "pipeline/twin/operator.py", "pipeline/simulation/expert.py"),
    "deploy_legged": (
        "stages/deploy_legged.py", "pipeline/disagreement.py", "pipeline/documents.py",
        *(f"pipeline/locomotion/{name}.py" for name in (
            "biped", "bodies", "body", "delay", "falls", "menagerie", "odometry", "played", "rewards", "robots",
            "scenes", "sensed", "spaces", "starts", "tasks", "torque", "tracing", "world")),
        "pipeline/ppo/policy.py", "pipeline/ppo/runner.py", "pipeline/shadow/candidate.py", "pipeline/shadow/limits.py",
        "pipeline/shadow/ridden.py", "pipeline/shadow/riders.py", "pipeline/shadow/sizes.py",
        "pipeline/shadow/targets.py", "pipeline/shadow/wire.py", "pipeline/twin/legged.py",
        "pipeline/twin/legged_law.py"),
})
"""What also decides them, by the stage that records: who acts, on which robot, and when an attempt ends."""


@cache
def versions() -> dict[str, str]:
    """Package -> installed version; read from metadata, nothing is imported."""
    found: dict[str, str] = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@cache
def commit() -> str:
    """Version control commit of this checkout, '+' added when files differ from it; 'unknown' elsewhere."""
    try:
        head = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=ROOT, capture_output=True, text=True,
                              check=True).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain", "--untracked-files=no"], cwd=ROOT,
                                 capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head + ("+" if changed else "")


def software(stage: str = "") -> dict[str, str]:
    """Strings for the metadata record of a recording that `stage` makes, or a person on a simulated robot.

    The code's hash stands in for the commit: a file must not change because a page of documentation did.
    """
    return {"software_commit": recording_code(stage)[:12],
            "simulator_version": f"mujoco {versions().get('mujoco', 'unknown')}"}


@cache
def recording_code(stage: str, root: Path = ROOT) -> str:
    """Hash of the files that decide the bytes of the recordings of a stage."""
    return source_hash(root / file for file in (*EVERY_RECORDING, *RECORDINGS_OF.get(stage, ())))


@cache
def stage_code(stage: str) -> str:
    """Hash of the source of one stage."""
    return source_hash([ROOT / "stages" / f"{stage}.py"])


def run_info(recipe: Recipe, seed: int, twin: int, arm: str) -> RunInfo:
    """What is noted of a run when it is invoked."""
    return RunInfo(recipe_name=recipe.name, recipe=recipe.model_dump(mode="json"), seed=seed, twin=twin, control=arm,
                   command=" ".join(["hardcase", *sys.argv[1:]]), commit=commit(), versions=versions())
