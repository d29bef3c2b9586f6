"""Facts about what runs: versions, commit, command line, hashes of the stages' sources."""

import subprocess
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pipeline.files import source_hash
from pipeline.store import RunInfo
from schemas.recipe import Recipe

PACKAGES = ("hardcase", "mujoco", "lerobot", "torch", "onnxruntime", "prefect", "mcap", "pyarrow", "numpy")
ROOT = Path(__file__).parents[1]


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


def software() -> dict[str, str]:
    """Strings for the metadata record of a recording.

    The code's hash stands in for the commit: a file must not change because a page of documentation did.
    """
    return {"software_commit": _code()[:12], "simulator_version": f"mujoco {versions().get('mujoco', 'unknown')}"}


@cache
def _code() -> str:
    folders = ("simulation", "twin", "recording")
    return source_hash(p for f in folders for p in (ROOT / "pipeline" / f).glob("*.py"))


@cache
def stage_code(stage: str) -> str:
    """Hash of the source of one stage."""
    return source_hash([ROOT / "stages" / f"{stage}.py"])


def run_info(recipe: Recipe, seed: int, twin: int, arm: str) -> RunInfo:
    """What is noted of a run when it is invoked."""
    return RunInfo(recipe_name=recipe.name, recipe=recipe.model_dump(mode="json"), seed=seed, twin=twin, control=arm,
                   command=" ".join(["hardcase", *sys.argv[1:]]), commit=commit(), versions=versions())
