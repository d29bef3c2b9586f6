"""kill -9 while a version is built: the last version is whole, the rerun ends in the same one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", ["state", "camera"])
def test_a_build_killed_at_any_step_leaves_whole_versions_and_ends_in_the_same_one(tmp_path, kind):
    script = Path(__file__).with_name("killed_build.py")
    done = subprocess.run([sys.executable, "-W", "ignore::DeprecationWarning", script, tmp_path, kind], cwd=ROOT,
                          env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    reports = json.loads(done.stdout)
    assert [r["killed"] for r in reports] == [True] * (len(reports) - 1) + [False]
    steps = {"fsync", "link", "rename", "chmod", "mkdir", "write_text"} | ({"replace"} if kind == "camera" else set())
    assert steps == set(done.stderr.split())
    assert all(r["whole"] and r["parent"] and not r["unfinished"] for r in reports)
    assert {r["left"] for r in reports[:-1]} == {1, 2}, "a kill before and one after the rename must both be seen"
    assert len({(r["id"], r["digest"]) for r in reports}) == 1
