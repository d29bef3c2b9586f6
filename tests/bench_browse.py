"""100 episodes ready to browse, and one: recordings made, layers laid, registered with a running catalog.

Beside it Rerun's own way in: its MCAP importer on the same files, which knows no labels, shapes of links or commands.
Wall time on a shared machine says little, so CPU time of this process (its threads included) is told as well.
Run: OMP_NUM_THREADS=1 pytest tests/bench_browse.py -s
"""

import resource
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from flows.browse.making import Making
from pipeline.browsing.catalog import serving
from pipeline.browsing.web import viewer_binary
from pipeline.files import short_id
from pipeline.store import RunInfo, Store
from schemas.recipe import CollectConfig, Recipe
from stages.collect import collect

EPISODES = 100
RUN = short_id("run", "bench browse")


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    """A store of 100 demonstrations of about 50 ticks."""
    folder = tmp_path_factory.mktemp("bench")
    recipe = Recipe(name="bench", collect=CollectConfig(demonstrations=EPISODES))
    recorded = collect(recipe, seed=0, folder=folder, software={})
    with Store.open(folder / "store", create=True) as store, store.lease(RUN) as lease:
        store.put_blobs([r.path for r in recorded])
        with store.commit(lease) as tx:
            tx.add_run(RunInfo(recipe_name="bench", recipe=recipe.model_dump(mode="json"), seed=0, twin=3,
                               command="hardcase loop", commit="abc1234", versions={}))
            tx.add_episodes([r.episode for r in recorded])
    return folder / "store"


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and CPU seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def test_episodes_are_ready_to_browse(root):
    with Store.open(root) as store, serving() as catalog:
        episodes = store.episodes()
        catalog.add("warm", [])  # the client is made at the first call, once a session
        ready = lambda chosen: catalog.add("arm", [Making(store).episode(e).entry for e in chosen])  # noqa: E731
        one = timed(lambda: ready(episodes[:1]))
        many = timed(lambda: ready(episodes))
        assert len(catalog.rows("arm")) == EPISODES
    with Store.open(root) as store, serving() as catalog:
        catalog.add("warm", [])
        again = timed(lambda: catalog.add("arm", [Making(store).episode(e).entry for e in episodes]))
        size = sum(p.stat().st_size for p in (root / "browse").iterdir()) / EPISODES / 1e3
        files = [store.blob(str(e.blob)) for e in episodes[:10]]
    theirs = _importer(files, root)
    print(f"\none episode: {one[0]:.2f} s, {one[1]:.2f} s CPU; {EPISODES}: {many[0]:.1f} s, {many[1]:.1f} s CPU; "
          f"again, from the cache: {again[0]:.1f} s, {again[1]:.1f} s CPU; {size:.0f} kB an episode\n"
          f"`rerun mcap convert`: {theirs * EPISODES / 10:.1f} s CPU for {EPISODES}, without labels, links or plots")
    assert many[1] < 30 and one[1] < 2


def _importer(files: list[Path], folder: Path) -> float:
    """CPU seconds of Rerun's own converter for some recordings."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    for k, file in enumerate(files):
        source = folder / f"{k}.mcap"
        source.symlink_to(file.absolute())
        subprocess.run([viewer_binary(), "mcap", "convert", source, "-o", folder / f"{k}.rrd"], check=True,
                       capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
