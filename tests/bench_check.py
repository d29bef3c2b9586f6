"""Checking recordings of the arm beside the tools that people check bags with today: baglint and tracecheck.

Both check rates, gaps and stamps by a contract (tracecheck sequences too) and decode no values; ours runs every check
of CHECKS that has something to look at, on decoded values. CPU time of one core.
Run: OMP_NUM_THREADS=1 pytest tests/bench_check.py -s
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from baglint.runner import run as baglint
from baglint.spec import Spec
from tracecheck.engine import analyze_file

from pipeline.check.load import read_recording
from pipeline.check.run import check
from pipeline.recording import read_attachments, read_episode, write_episode
from pipeline.recording.dialect import FRAME_TOPICS
from schemas.contract import Contract
from schemas.recipe import CollectConfig, Recipe
from stages.collect import collect

EPISODES, TIMES = 10, 100
SPEC = Spec.from_dict({"topics": {name: {"min_rate": 19, "max_gap_ms": 250, "check_stamps": True}
                                  for name in FRAME_TOPICS}})
TERMS = {"version": 1, "name": "bench", "topics": {
    name: {"required": True, "time_basis": "log_time", "clock_confirmed": True, "min_rate_hz": 19,
           "max_gap_ns": 250_000_000, "sequence": "increment_mod32"} for name in FRAME_TOPICS}}


@pytest.fixture(scope="module")
def episodes(tmp_path_factory) -> list[Path]:
    """Demonstrations of some 50 ticks."""
    recipe = Recipe(name="bench", collect=CollectConfig(demonstrations=EPISODES))
    return [r.path for r in collect(recipe, seed=1, folder=tmp_path_factory.mktemp("demos"), software={})]


@pytest.fixture(scope="module")
def long(episodes, tmp_path_factory) -> list[Path]:
    """One of them there and back, again and again: some 4 minutes."""
    episode, trace = read_episode(episodes[0])

    def again(rows: np.ndarray) -> np.ndarray:
        return np.concatenate([rows if k % 2 == 0 else rows[::-1] for k in range(TIMES)])

    arrays = {f.name: again(value) for f in dataclasses.fields(trace)
              if isinstance(value := getattr(trace, f.name), np.ndarray)}
    ticks = len(trace) * TIMES
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    write_episode(path, episode.model_copy(update={
        "frames": ticks, "blob": None, "segments": (episode.segments[0].model_copy(update={"stop": ticks}),)}),
        dataclasses.replace(trace, **arrays, phase=("again",) * ticks, events=(),
                            reward={name: again(rows) for name, rows in trace.reward.items()}),
        attachments=read_attachments(episodes[0]))
    return [path]


def spent(work: Callable[[Path], object], paths: list[Path], rounds: int = 5) -> float:
    """CPU seconds for all of them, the median of some rounds."""
    taken: list[float] = []
    for _ in range(rounds):
        start = time.process_time()
        for path in paths:
            work(path)
        taken.append(time.process_time() - start)
    return float(np.median(taken))


@pytest.mark.parametrize("kind", ["episodes", "long"])
def test_check_beside_baglint_and_tracecheck(kind, benchmark, request):
    paths: list[Path] = request.getfixturevalue(kind)
    read = [read_recording(path) for path in paths]
    messages = sum(len(t) for subject in read for t in subject.recordings[0].topics.values())
    ours = spent(lambda path: check(read_recording(path), Contract()), paths)
    reading = spent(read_recording, paths)
    lint = spent(lambda path: baglint(path, SPEC), paths)
    trace = spent(lambda path: analyze_file(path, TERMS), paths)
    benchmark.pedantic(lambda: check(read_recording(paths[0]), Contract()), rounds=5)
    benchmark.extra_info |= {"messages_per_cpu_s": messages / ours, "baglint": lint / ours, "tracecheck": trace / ours}
    print(f"\n{kind}: {messages} messages in {len(paths)} recordings, {1e3 * ours / len(paths):.1f} ms each for "
          f"{len(check(read[0], Contract()).checks)} checks, {reading / ours:.0%} of it to read and decode; baglint "
          f"takes {lint / ours:.1f} and tracecheck {trace / ours:.1f} times as long")
