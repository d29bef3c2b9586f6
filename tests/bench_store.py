"""What the store costs a loop. Run: pytest tests/bench_store.py --benchmark-columns=median,max"""

import itertools
import subprocess
import sys

from pipeline.files import short_id
from pipeline.store import RunInfo, Store
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import Draw, SceneSpec

RUN = "0123456789abcdef"
INFO = RunInfo(recipe_name="bench", recipe={}, seed=0, twin=0, command="bench")


def episode(k: int, blob: str | None = None) -> Episode:
    scene = SceneSpec(
        family="deploy", seed=k, robot="arm", scene="table", task="pick-place", stratum="common",
        object_xy_m=(0.3, 0.0), object_yaw_rad=0.0, object_half_m=0.02, target_xy_m=(0.3, 0.2),
        draws=tuple(Draw(name=f"draw{i}", unit="1", value=k / (i + 1)) for i in range(10)),
    )  # fmt: skip
    return Episode(
        id=short_id(k), origin="scripted", scene=scene, control_hz=20.0, frames=150, generation=0, blob=blob,
        outcome=Outcome(label="success", judged_by="sensors"),
        segments=(Segment(kind="demonstration", start=0, stop=150, actor="expert"),),
    )  # fmt: skip


def opened(path) -> Store:
    store = Store.open(path / "store", create=True)
    with store.lease(RUN) as lease, store.commit(lease) as tx:
        tx.add_run(INFO)
    return store


def test_opening_a_store(benchmark, tmp_path):
    opened(tmp_path).close()
    benchmark(lambda: Store.open(tmp_path / "store", create=True).close())
    assert benchmark.stats["median"] < 0.05  # [s]; every command opens one


def test_a_commit_of_one_episode(benchmark, tmp_path):
    number = itertools.count()
    with opened(tmp_path) as store, store.lease(RUN) as lease:

        def commit() -> None:
            with store.commit(lease) as tx:
                tx.add_episodes([episode(next(number))])

        benchmark.pedantic(commit, rounds=100)
    assert benchmark.stats["median"] < 0.1  # [s]; one fsync of the WAL, the rest is small


def test_a_deployment_of_150_recordings(benchmark, tmp_path):
    number = itertools.count()
    with opened(tmp_path) as store, store.lease(RUN) as lease:

        def deploy() -> None:
            ks = [next(number) for _ in range(150)]
            blobs = store.put_blobs(k.to_bytes(8) * 6000 for k in ks)
            with store.commit(lease) as tx:
                tx.add_episodes(episode(k, blob) for k, blob in zip(ks, blobs, strict=True))

        benchmark.pedantic(deploy, rounds=8)
    assert benchmark.stats["median"] < 2.0  # [s]; 48 kB each; four of them in a demo of 180 s


def test_reading_1000_episodes(benchmark, tmp_path):
    with opened(tmp_path) as store, store.lease(RUN) as lease:
        with store.commit(lease) as tx:
            tx.add_episodes(episode(k) for k in range(1000))
        assert len(benchmark(store.episodes)) == 1000
    assert benchmark.stats["median"] < 0.2  # [s]


def test_importing_the_store(benchmark):
    heavy = "{'torch', 'mujoco', 'lerobot', 'prefect', 'numpy'}"
    code = f"import sys, time, pipeline.store as s; assert not {heavy} & set(sys.modules); print(time.process_time())"
    command = [sys.executable, "-c", code]
    runs: list[float] = []
    benchmark.pedantic(
        lambda: runs.append(float(subprocess.run(command, check=True, capture_output=True).stdout)), rounds=5
    )
    assert min(runs) < 0.3  # [CPU s]; `hardcase --help` has 0.7
