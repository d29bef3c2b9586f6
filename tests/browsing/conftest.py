"""A store with attempts of several kinds, made by the real stages, and the real command line over it."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.files import short_id
from pipeline.recording import Recording, read_episode, read_frames, write_episodes
from pipeline.recording.read import open_recording
from pipeline.shards import write_shard
from pipeline.store import RunInfo, Store
from pipeline.trace import Event, Shadow
from schemas.episode import Episode, Outcome
from schemas.recipe import AugmentConfig, CollectConfig, Recipe
from stages.augment import augment
from stages.collect import collect

ROOT = Path(__file__).parents[2]
RUN = short_id("run", "browsing")

def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: takes many seconds; leave out with -m 'not slow'")


@dataclass(frozen=True)
class Shelf:
    """A store on disk and what was put into it."""

    root: Path
    demonstrations: list[Episode]
    variants: list[Episode]
    failure: Episode

    def start(self, *arguments: str, **environment: str) -> "subprocess.Popen[str]":
        clean = {k: v for k, v in os.environ.items()
                 if not k.startswith(("HARDCASE", "DISPLAY", "WAYLAND", "COLUMNS", "PREFECT"))}
        own = {"HARDCASE_STORE": str(self.root), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **environment}
        return subprocess.Popen([sys.executable, "-m", "flows.cli", "browse", *arguments], cwd=ROOT, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=clean | own)

    def run(self, *arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=240)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@pytest.fixture(scope="session")
def shelf(tmp_path_factory) -> Shelf:
    folder = tmp_path_factory.mktemp("shelf")
    recipe = Recipe(name="browsing", collect=CollectConfig(demonstrations=2))
    recorded = collect(recipe, seed=0, folder=folder, software={})
    demonstrations = [r.episode for r in recorded]
    parents = [(r.episode, read_frames(r.path)[1]) for r in recorded]
    made = augment(parents, AugmentConfig(), replays=1, retargets=1, seed=0, generation=0, threads=1)
    write_shard(folder / "shard.arrow", made.frames)
    failure = _failed(recorded[0].path, folder / "failed.mcap")
    with Store.open(folder / "store", create=True) as store, store.lease(RUN) as lease:
        shard = store.put_blob(folder / "shard.arrow")
        for path in (*(r.path for r in recorded), folder / "failed.mcap"):
            store.put_blob(path)
        variants = [e.model_copy(update={"blob": shard}) for e in made.episodes]
        with store.commit(lease) as tx:
            tx.add_run(RunInfo(recipe_name="browsing", recipe=recipe.model_dump(mode="json"), seed=0, twin=3,
                               command="hardcase loop", commit="abc1234", versions={}))
            tx.add_episodes([*demonstrations, *variants, failure])
    return Shelf(folder / "store", demonstrations, variants, failure)


def _failed(source: Path, target: Path) -> Episode:
    """A recording of an attempt that was stopped, with a shadow policy and a trigger."""
    episode, trace = read_episode(source)
    m = len(trace)
    apart = Shadow(trace.joint_action + 0.1, np.linspace(0.0, 1.0, m))
    phases = ("reach",) * (m // 2) + ("carry",) * (m - m // 2)
    trace = replace(trace, phase=phases, shadows={"feedfeedfeedfeed": apart},
                    events=(Event(m - 1, 30, "trigger", "dropped"),))
    record = episode.model_copy(update={
        "id": short_id("failed"), "blob": None, "generation": 2,
        "outcome": Outcome(label="failure", judged_by="sensors", trigger="dropped", family="dropped-carry",
                           tick=m - 1)})
    (sha,) = write_episodes([Recording(target, record, trace, open_recording(source).attachments, {})])
    return record.model_copy(update={"blob": sha})


@pytest.fixture
def store(shelf):
    with Store.open(shelf.root) as opened:
        yield opened


@pytest.fixture(scope="session")
def columns() -> Callable[..., dict[str, list[object]]]:
    """Reads a dataset of a catalog as a viewer would: column -> values of one episode, by tick."""
    def read(catalog, dataset: str, episode: str) -> dict[str, list[object]]:
        entry = catalog._client_now().get_dataset(dataset)
        return entry.filter_segments([episode]).reader(index="tick").to_pydict()
    return read
