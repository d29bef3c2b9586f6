"""The training side runs with the twin's hidden physics deleted: it cannot have looked."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAYERS = ("schemas", "pipeline", "stages", "flows", "datasets/recipes")


@pytest.fixture(scope="module")
def lawless(tmp_path_factory):
    """Runs the command line of a copy of the packages that lacks pipeline/twin/law.py, on a store of its own."""
    copy = tmp_path_factory.mktemp("lawless")
    for layer in LAYERS:
        shutil.copytree(ROOT / layer, copy / layer, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "pipeline/twin/law.py").unlink()
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("HARDCASE", "PREFECT"))}
    environment = clean | {"HARDCASE_STORE": str(copy / "store"), "PYTHONPATH": str(copy), "HARDCASE_DEBUG": "1"}

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "flows.cli", *arguments],
                              env=environment, cwd=copy, capture_output=True, text=True, timeout=240)

    return call


def test_collect_to_release_run_without_the_hidden_physics_and_deploy_does_not(lawless):
    began = lawless("collect", "--recipe", "smoke", "--json")
    assert began.returncode == 0, began.stderr
    for stage in ("augment", "build", "train", "gate", "release"):
        done = lawless(stage, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["ids"]
    refused = lawless("deploy")
    assert refused.returncode != 0
    assert "law" in refused.stderr.splitlines()[-1] and "ImportError" in refused.stderr
