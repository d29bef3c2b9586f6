"""hardcase why and hardcase forget as people meet them, on the store of a real loop."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.recording import read_frames
from pipeline.store import Store

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def copied(turned, tmp_path_factory):
    """A copy of the store of a whole loop, and the command line on it."""
    folder = tmp_path_factory.mktemp("copied")
    subprocess.run(["cp", "-a", turned.store, folder / "store"], check=True)  # hard links stay hard links

    def call(*words):
        return subprocess.run([sys.executable, "-m", "flows.cli", *map(str, words)], cwd=ROOT, text=True,
                              capture_output=True, timeout=200, check=False,
                              env=turned.environment | {"HARDCASE_STORE": str(folder / "store"),
                                                        "HF_HOME": str(folder / "hf")})

    return folder / "store", call


def test_why_draws_both_directions_of_a_real_policy(copied, tmp_path):
    root, call = copied
    with Store.open(root) as store:
        policy = store.policies()[0]
    done = call("why", policy.id[:8], "--svg", tmp_path / "why.svg")
    assert done.returncode == 0, done.stderr
    assert "used by:" in done.stdout and "draws: " in done.stdout and "recipe: smoke" in done.stdout
    drawn = (tmp_path / "why.svg").read_text()
    assert f"policy {policy.id}" in drawn and "8 demonstrations" in drawn and "attempts at work" in drawn
    forward = call("why", policy.id, "--forward").stdout
    assert "draws: " not in forward and "used by:" in forward


@pytest.mark.parametrize("words, message", [
    (("why", "ffffffff"), "is not in the store"), (("why", "../x"), "not a valid id: '../x'"),
    (("forget", "ffffffff", "--reason", "x"), "is not in the store"),
    (("forget", "EPISODE"), "why is it forgotten?"), (("forget", "EPISODE", "--reason", "  "), "why is it forgotten?"),
    (("why", "EPISODE", "--svg", "why.png"), "'why.png' is no name of a picture"),
    (("why", "EPISODE", "--svg", "/proc/why.svg"), "the picture cannot be written"),
])
def test_what_cannot_be_done_is_one_line_and_its_mend(copied, words, message):
    root, call = copied
    with Store.open(root) as store:
        episode = store.episodes(origin="deployed")[0].id
    done = call(*(episode if w == "EPISODE" else w for w in words))
    assert done.returncode == 2 and done.stdout == ""
    what, at, mend = done.stderr.strip().split("\n")
    assert message in what and at.startswith("  at:   ") and mend.startswith("  mend: ")


def test_no_byte_of_a_forgotten_demonstration_is_left_of_a_real_loop(copied, turned):
    root, call = copied
    with Store.open(root) as store:
        demo = store.episodes(origin="scripted")[1]
        file = store.blob(demo.blob)
        state, packed = read_frames(file)[1].state, file.read_bytes()
        runs = [run for run, info in store.runs().items() if not info.control]
    forms = [packed[k:k + 48] for k in range(len(packed) // 4, 3 * len(packed) // 4, len(packed) // 16)]
    with Store.open(root) as store:  # what recordings have in common, such as the model of the robot, is in others, too
        others = [store.blob(e.blob).read_bytes() for e in store.episodes(origin="scripted") if e.id != demo.id]
    forms = [f for f in forms if not any(f in other for other in others)]
    rows = {row.tobytes() for row in state[5:40]}

    def found():
        files = [p for p in root.rglob("*") if p.is_file()]
        tables = [p for p in files if p.suffix == ".parquet" and "data" in p.parts]
        return [str(p.relative_to(root)) for p in files if any(form in p.read_bytes() for form in forms)] + [
            str(p.relative_to(root)) for p in tables
            if rows & {np.float32(r).tobytes() for r in pq.read_table(p)["observation.state"].to_pylist()}]

    before = found()
    assert forms and {name.split("/")[0] for name in before} >= {"blobs", "versions"}
    planned = call("forget", demo.id, "--reason", "asked")
    assert planned.returncode == 0 and "nothing was touched; to erase it, add: --yes" in planned.stdout
    assert found() == before and (root / "reports" / f"{runs[0]}.html").is_file()
    done = call("forget", demo.id, "--reason", "asked", "--yes", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["champion_of"] and len(told["versions"]) >= 2 and told["freed"] > 0
    assert found() == [] and not (root / "reports" / f"{runs[0]}.html").exists()
    for version in told["versions"]:
        assert "incomplete" in call("why", version).stdout
    assert call("report", "--run", runs[0]).returncode == 0
    assert (root / "reports" / f"{runs[0]}.html").is_file() and found() == []
    resumed = call("augment", "--run", runs[0], "--json")
    assert resumed.returncode == 0, resumed.stderr
