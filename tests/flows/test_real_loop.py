"""The real loop as a person runs it: real stages, real processes, killed, resumed, and read back.

One finished smoke loop with its control is shared by most tests; those that need lerobot are here too, so that
one process imports it.
"""

import json
import logging
import os
import re
import sqlite3
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.estimate import plan
from pipeline.frames import FEATURES
from pipeline.recipes import load_recipe
from pipeline.recording import read_frames
from pipeline.shards import read_shard
from pipeline.store import StepManifest, Store
from schemas.episode import VARIANTS
from schemas.summary import LoopResult

pytestmark = pytest.mark.xdist_group("lerobot")

ROOT = Path(__file__).parents[2]
LINE = re.compile(r"(control )?generation \d/1  \w+ +(\d+\.\d s|kept)  .+$")
LAP = ("augment", "build", "train", "gate", "release", "exam", "deploy", "harvest")


@dataclass
class Loop:
    """The command line on a store of its own."""

    folder: Path

    @property
    def store(self) -> Path:
        return self.folder / "store"

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "HARDCASE", "COLUMNS", "DISPLAY"))}
        return subprocess.Popen(
            [sys.executable, "-m", "flows.cli", *arguments], cwd=ROOT, text=True, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=clean | {"HARDCASE_STORE": str(self.store), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments)
        out, err = process.communicate(timeout=200)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def result(self) -> LoopResult:
        return LoopResult.model_validate_json((self.folder / "result.json").read_text())

    def manifests(self) -> dict[tuple[object, ...], tuple[object, ...]]:
        """(run, generation, stage) -> rowid and wall time: both change where a stage is done again."""
        try:
            catalog = sqlite3.connect(f"file:{self.store / 'catalog.db'}?mode=ro", uri=True)
            rows = catalog.execute("SELECT rowid, json FROM step").fetchall()
            catalog.close()
        except sqlite3.OperationalError:  # the store is not there yet
            return {}
        steps = [(rowid, StepManifest.model_validate_json(text)) for rowid, text in rows]
        return {(s.run, s.generation, s.stage): (rowid, s.wall_s) for rowid, s in steps}

    def says(self, run: str) -> list[tuple[object, ...]]:
        """Everything that the manifests of a run say, times left out."""
        with Store.open(self.store) as store:
            return [(s.generation, s.stage, s.inputs, s.outputs, s.code) for s in store.steps(run)]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Loop:
    """One whole loop with its control."""
    loop = Loop(tmp_path_factory.mktemp("finished"))
    loop.done = loop.run("loop", "--recipe", "smoke", "--control", "--json", str(loop.folder / "result.json"))
    assert loop.done.returncode == 0, loop.done.stderr
    return loop


@pytest.fixture(scope="module")
def store(finished) -> Iterator[Store]:
    with Store.open(finished.store) as opened:
        yield opened


@pytest.fixture(scope="module")
def run(store) -> str:
    """Id of the loop; its control is another run."""
    return next(id for id, info in store.runs().items() if not info.control)


def test_the_json_has_the_promised_shape(finished):
    told = json.loads((finished.folder / "result.json").read_text())
    assert set(told) == {"generations", "control", "paired", "wall_s", "peak_pss_mb", "seed", "twin"}
    assert set(told["paired"]) == {"fixed", "broken", "p"}
    for lap in (*told["generations"], *told["control"]):
        assert set(lap) == {"generation", "dataset_version", "policy", "success", "gate", "robot_s", "corrections",
                            "wall_s"}
        assert set(lap["success"]) == {"all", "common", "rare", "deployment_mix"}
        assert all(set(p) == {"n", "successes", "rate", "low", "high"} for p in lap["success"].values())
        assert set(lap["gate"]) == {"verdict", "p"}
    assert [lap["generation"] for lap in told["generations"]] == [0, 1]
    assert set(told["generations"][0]["wall_s"]) == {"collect", *LAP}
    assert (told["seed"], told["twin"]) == (0, 100)
    assert told["wall_s"] > 1 and 100 < told["peak_pss_mb"] < 1500


def test_nothing_but_one_line_a_stage_reaches_stderr(finished):
    lines = finished.done.stderr.splitlines()
    assert len(lines) == len(plan(load_recipe("smoke"), control=True))
    assert [line for line in lines if not LINE.match(line)] == []


def test_stdout_is_the_table_and_the_path_of_a_report_that_is_there(finished, run):
    out = finished.done.stdout
    assert not re.search(r"Traceback|WARNING|Warning", out)
    page = Path(re.search(r"^Report: (.+)$", out, re.MULTILINE)[1])
    assert page == finished.store / "reports" / f"{run}.html"
    text = page.read_text()
    assert "<html" in text and finished.result().generations[-1].policy in text


def test_the_control_shares_generation_0_and_learns_from_as_many_new_episodes(finished):
    told = finished.result()
    first, control = told.generations[0], told.control[0]
    assert control.model_copy(update={"wall_s": first.wall_s}) == first
    assert told.control[1].dataset_version != told.generations[1].dataset_version
    assert told.control[1].corrections == told.generations[1].corrections > 0


def test_every_lap_grew_from_what_the_one_before_it_harvested(finished, store, run):
    zero, one = store.versions(run=run)
    corrected = {e.id for e in store.episodes(store.step(run, 0, "harvest").outputs["ids"])
                 if e.outcome.label == "success"}
    assert corrected and corrected <= set(one.episodes)
    assert one.episodes[:len(zero.episodes)] == zero.episodes
    assert [lap.dataset_version for lap in finished.result().generations] == [zero.id, one.id]


def test_the_exam_has_the_same_scenes_in_every_generation(store):
    strata = [result["strata"] for id in store.runs() for step in store.steps(id) if step.stage == "exam"
              for result in step.outputs["results"].values()]
    assert len(strata) >= 4
    assert all(found == strata[0] for found in strata)


def test_tables_of_a_version_equal_what_was_recorded(store, run):
    version = store.versions(run=run)[-1]
    table = pa.concat_tables(pq.read_table(f) for f in sorted(store.path(version.path).glob("data/*/*.parquet")))
    episodes = store.episodes(version.episodes)
    assert {"scripted", "corrected"} < {e.origin for e in episodes}
    index = table["episode_index"].to_numpy()
    for number, episode in enumerate(episodes):
        blob = store.blob(episode.blob)
        frames = read_shard(blob)[episode.id] if episode.origin in VARIANTS else read_frames(blob)[1]
        rows = table.filter(index == number)
        for name, recorded in frames.columns().items():
            assert np.array_equal(np.stack(rows[name].to_numpy(zero_copy_only=False)), recorded), (episode.id, name)
    assert len(table) == version.frames


def test_lerobot_opens_every_version_without_a_warning(store, tmp_path, monkeypatch):
    for name in ("HF_HOME", "HF_DATASETS_CACHE", "HF_LEROBOT_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    class Loud(logging.Handler):
        def emit(self, record):
            raise AssertionError(f"{record.name} logged: {record.getMessage()}")

    loud = Loud(logging.WARNING)
    logging.getLogger().addHandler(loud)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for version in store.versions():
                data = LeRobotDataset("hardcase/version", root=store.path(version.path), video_backend="pyav")
                assert len(data) == version.frames
                assert set(FEATURES) <= set(data[len(data) - 1])
    finally:
        logging.getLogger().removeHandler(loud)


def test_why_walks_from_a_policy_back_to_recordings_draws_seeds_and_code(finished, store, run):
    policy = store.policies(run=run)[-1]
    told = finished.run("why", policy.id[:8])
    assert told.returncode == 0, told.stderr
    episodes = store.episodes(store.version(policy.dataset).episodes)
    correction = next(e for e in episodes if e.origin == "corrected")
    for words in (policy.id, policy.dataset, policy.code[:12], "seed", "draws", "friction", "collect", "recordings",
                  correction.blob[:12]):
        assert words in told.stdout, f"{words} is not in\n{told.stdout}"
    whole = json.loads(finished.run("why", policy.id, "--json").stdout)
    text = json.dumps(whole)
    assert all(e.id in text and e.blob in text and str(e.scene.seed) in text for e in episodes)


def test_the_same_order_again_redoes_nothing(finished):
    before = finished.manifests()
    again = finished.run("loop", "--recipe", "smoke", "--control", "--json", str(finished.folder / "again.json"))
    assert again.returncode == 0, again.stderr
    assert finished.manifests() == before
    assert all(" kept " in line for line in again.stderr.splitlines()[:-1])
    told = LoopResult.model_validate_json((finished.folder / "again.json").read_text())
    assert (told.generations, told.control, told.paired) == (
        finished.result().generations, finished.result().control, finished.result().paired)


def kill(process: subprocess.Popen[str], when: Callable[[], object], what: str) -> None:
    """Kill -9 as soon as `when` holds."""
    end = time.monotonic() + 60
    while not when():
        assert process.poll() is None, f"it ended before {what}: {process.communicate()[1]}"
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.001)
    process.kill()
    process.communicate()


def test_a_loop_killed_at_any_point_ends_where_an_unbroken_one_does(finished, run, tmp_path):
    loop = Loop(tmp_path)

    def done(generation: int, stage: str) -> Callable[[], object]:
        return lambda: (run, generation, stage) in loop.manifests()

    def there(pattern: str) -> Callable[[], object]:
        return lambda: next(loop.store.glob(pattern), None)

    moments = {
        "inside collect": there(f"tmp/{run}/*.mcap*"),
        "after collect": done(0, "collect"),
        "inside train, a checkpoint written": there("policies/.*.training/step-*"),
        "after train": done(0, "train"),
        "inside deploy": lambda: done(0, "exam")() and there(f"tmp/{run}/*.mcap*")(),
        "inside harvest": lambda: done(0, "deploy")() and there(f"tmp/{run}/*.mcap*")(),
        "after build": done(1, "build"),
    }
    first = ("loop", "--recipe", "smoke")
    for moment, when in moments.items():
        before = loop.manifests()
        kill(loop.start(*first), when, moment)
        first = ("loop", "--resume")
        after = loop.manifests()
        assert before.items() <= after.items(), f"{moment}: a finished stage was done again"
    before = loop.manifests()
    last = loop.run("loop", "--resume", "--json", str(loop.folder / "result.json"))
    assert last.returncode == 0, last.stderr
    assert before.items() <= loop.manifests().items()
    assert loop.says(run) == finished.says(run)
    for one, other in zip(loop.result().generations, finished.result().generations, strict=True):
        assert one.model_copy(update={"wall_s": {}}) == other.model_copy(update={"wall_s": {}})
    with Store.open(loop.store) as broken, Store.open(finished.store) as whole:
        assert broken.versions(run=run) == whole.versions(run=run)
        assert broken.policies(run=run) == whole.policies(run=run)
        assert broken.releases(run) == whole.releases(run)
        assert broken.hard_cases(run=run) == whole.hard_cases(run=run)
        assert broken.verify() == []


def test_a_second_loop_on_one_store_is_refused_and_told_who_holds_it(tmp_path):
    loop = Loop(tmp_path)
    holder = loop.start("loop", "--recipe", "smoke", "--generations", "0")
    try:
        while not loop.manifests():
            assert holder.poll() is None, holder.communicate()[1]
            time.sleep(0.01)
        refused = loop.run("collect", "--recipe", "smoke", "--seed", "1")
    finally:
        holder.terminate()
        holder.communicate(timeout=60)
    assert refused.returncode == 2
    assert str(holder.pid) in refused.stderr
    assert re.search(r"^  mend: ", refused.stderr, re.MULTILINE)
    assert "Traceback" not in refused.stderr


def test_each_stage_by_hand_does_what_the_loop_does(finished, run, tmp_path):
    loop = Loop(tmp_path)
    assert loop.run("collect", "--recipe", "smoke").returncode == 0
    early = loop.run("deploy")
    assert early.returncode == 2
    assert early.stderr.splitlines() == [
        "nothing is released yet", f"  at:   run {run}", "  mend: hardcase gate && hardcase release"]
    for stage in (*LAP, "report"):
        done = loop.run(stage, "--json")
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        told = json.loads(done.stdout)
        assert (told["stage"], told["resumed"]) == (stage, False)
    by_hand = [said for said in loop.says(run)]
    assert by_hand == [said for said in finished.says(run) if said[0] == 0]
    assert Path(told["ids"][0]).read_text().startswith("<!")
