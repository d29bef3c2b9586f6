"""A small run to put into stores, and processes of our own to kill."""

import os
import signal
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.files import sha256, short_id
from pipeline.store import RunInfo, Store
from schemas.dataset import DatasetVersion
from schemas.episode import Episode, Outcome, Segment
from schemas.hardcase import HardCase
from schemas.policy import PolicyRecord
from schemas.release import Release
from schemas.scene import Draw, SceneSpec
from schemas.verdict import Proportion, StratumResult, Verdict

CODE = sha256(b"code")


@dataclass(frozen=True)
class Small:
    """One lap in miniature; everything follows from the seed."""

    seed: int = 0

    @property
    def run(self) -> str:
        return short_id("run", self.seed)

    def info(self, **change: object) -> RunInfo:
        base = RunInfo(
            recipe_name="smoke",
            recipe={"name": "smoke", "generations": 1},
            seed=self.seed,
            twin=3,
            command="hardcase loop --recipe smoke",
            commit="abc1234",
            versions={"mujoco": "4.0.0"},
        )
        return base.model_copy(update=change)

    def recording(self, k: int) -> bytes:
        return f"recording {k} of {self.seed}".encode() * 50

    def episode(self, k: int, **change: object) -> Episode:
        scene = SceneSpec(
            family="demo",
            seed=k,
            robot="arm",
            scene="table",
            task="pick-place",
            stratum="common" if k % 3 else "large",
            object_xy_m=(0.3, 0.0),
            object_yaw_rad=0.0,
            object_half_m=0.02,
            target_xy_m=(0.3, 0.2),
            draws=(Draw(name="friction", unit="1", value=0.4 + k / 100),),
        )
        base = Episode(
            id=short_id("demo", self.seed, k),
            origin="scripted",
            scene=scene,
            control_hz=20.0,
            frames=10,
            outcome=Outcome(label="success", judged_by="simulator"),
            generation=0,
            segments=(Segment(kind="demonstration", start=0, stop=10, actor="expert"),),
        )
        return Episode.model_validate(base.model_dump() | change)

    def variant(self, k: int, of: Episode, **change: object) -> Episode:
        return self.episode(
            k, id=short_id("variant", self.seed, k), origin="retargeted", parent=of.id, transform="retarget", **change
        )

    def version(self, episodes: list[Episode], **change: object) -> DatasetVersion:
        id = short_id("version", self.seed, *(e.id for e in episodes))
        base = DatasetVersion(
            id=id,
            digest=sha256(id.encode()),
            recipe="smoke",
            generation=0,
            path=f"versions/{id}",
            episodes=tuple(e.id for e in episodes),
            held_out=(episodes[0].id,),
            weights={"base": 1.0},
            inputs=tuple(e.blob for e in episodes if e.blob),
            code=CODE,
            frames=10 * len(episodes),
        )
        return base.model_copy(update=change)

    def policy(self, version: DatasetVersion, seed: int = 0, **change: object) -> PolicyRecord:
        id = short_id("policy", version.id, seed)
        base = PolicyRecord(
            id=id,
            kind="chunked",
            dataset=version.id,
            seed=seed,
            generation=version.generation,
            steps=100,
            config=sha256(b"config"),
            code=CODE,
            checkpoint=f"policies/{id}",
            files={"policy.onnx": sha256(f"onnx {id}".encode())},
            train_loss=((100, 0.1),),
            held_out_loss=((100, 0.2),),
            onnx_error=1e-7,
        )
        return base.model_copy(update=change)

    def verdict(self, candidate: PolicyRecord, champion: PolicyRecord | None = None, **change: object) -> Verdict:
        rate = Proportion(n=100, successes=60, rate=0.6, low=0.5, high=0.69)
        base = Verdict(
            id=short_id("verdict", candidate.id),
            candidate=candidate.id,
            champion=champion and champion.id,
            generation=candidate.generation,
            decision="PASS" if champion else "BOOTSTRAP",
            reason="good enough",
            strata=(StratumResult(stratum="all", candidate=rate),),
            scenes=100,
            margin=0.05,
        )
        return base.model_copy(update=change)

    def release(
        self,
        number: int,
        policy: PolicyRecord,
        previous: str | None = None,
        verdict: str | None = None,
        kind: str = "promotion",
    ) -> Release:
        return Release.model_validate(
            {
                "number": number,
                "policy": policy.id,
                "previous": previous,
                "verdict": verdict,
                "kind": kind,
                "onnx": f"{policy.checkpoint}/policy.onnx",
            }
        )

    def hard_case(self, episode: Episode, **change: object) -> HardCase:
        base = HardCase(
            id=short_id("case", episode.id),
            episode=episode.id,
            trigger="stall",
            tick=7,
            family="missed",
            stratum=episode.scene.stratum,
            generation=0,
        )
        return base.model_copy(update=change)

    def write_folders(self, store: Store, version: DatasetVersion, policy: PolicyRecord) -> None:
        for folder, name, data in (
            (version.path, "data.parquet", b"rows"),
            (policy.checkpoint, "policy.onnx", f"onnx {policy.id}".encode()),
        ):
            store.path(folder).mkdir(parents=True, exist_ok=True)
            (store.path(folder) / name).write_bytes(data)

    def lap(self, store: Store, demonstrations: int = 6) -> PolicyRecord:
        """Collect, augment, build, train, gate, release and one hard case: seven commits."""
        with store.lease(self.run) as lease:
            demos = [self.episode(k, blob=store.put_blob(self.recording(k))) for k in range(demonstrations)]
            with store.commit(lease) as tx:
                tx.add_run(self.info())
                tx.add_episodes(demos)
                tx.finish_step(0, "collect", outputs={"episodes": len(demos)}, code=CODE, wall_s=1.5)
            variants = [self.variant(k, of=demos[k % len(demos)]) for k in range(100, 100 + 2 * demonstrations)]
            with store.commit(lease) as tx:
                tx.add_episodes(variants)
                tx.finish_step(0, "augment", code=CODE)
            version = self.version(demos + variants)
            policy = self.policy(version)
            self.write_folders(store, version, policy)
            with store.commit(lease) as tx:
                tx.add_version(version)
                tx.finish_step(0, "build", outputs={"version": version.id}, code=CODE)
            with store.commit(lease) as tx:
                tx.add_policy(policy)
                tx.finish_step(0, "train", inputs={"dataset": version.id}, outputs={"policy": policy.id}, code=CODE)
            with store.commit(lease) as tx:
                tx.add_verdict(self.verdict(policy))
                tx.finish_step(0, "gate", code=CODE)
            with store.commit(lease) as tx:
                tx.add_release(self.release(1, policy, verdict=self.verdict(policy).id, kind="bootstrap"))
                tx.finish_step(0, "release")
            failed = self.episode(
                900,
                id=short_id("deploy", self.seed),
                origin="deployed",
                policy=policy.id,
                outcome=Outcome(label="failure", judged_by="sensors", trigger="stall", tick=7),
                blob=store.put_blob(self.recording(900)),
            )
            with store.commit(lease) as tx:
                tx.add_episodes([failed])
                tx.add_hard_cases([self.hard_case(failed)])
                tx.finish_step(0, "harvest", code=CODE)
        return policy


@pytest.fixture
def small() -> Small:
    return Small()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "store"


@pytest.fixture
def store(root: Path):
    with Store.open(root, create=True) as opened:
        yield opened


@pytest.fixture
def in_child() -> Callable[[Callable[[], object]], int]:
    """Run a function in a process of its own and wait: its exit code, or minus the signal that ended it."""

    def run(body: Callable[[], object]) -> int:
        return os.waitstatus_to_exitcode(os.waitpid(start(body), 0)[1])

    return run


def start(body: Callable[[], object]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the child runs only what it is given
        child = os.fork()
    if child == 0:
        code = 1
        try:
            body()
            code = 0
        finally:
            os._exit(code)
    return child


@pytest.fixture
def children():
    """Start functions as processes that are killed at the end, if they still live."""
    started: list[int] = []

    def begin(body: Callable[[], object]) -> int:
        started.append(start(body))
        return started[-1]

    yield begin
    for child in started:
        try:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        except (ProcessLookupError, ChildProcessError):
            pass
