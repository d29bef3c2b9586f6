"""A small run to put into stores, and processes of our own to kill."""

import base64
import os
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import simplejpeg
from mcap.reader import make_reader

from pipeline.files import sha256, short_id
from pipeline.footage import source_of
from pipeline.frames import FEATURES, Frames
from pipeline.lerobot_view.video import decoded
from pipeline.recording import write_episode
from pipeline.shards import write_shard
from pipeline.store import RunInfo, Store
from pipeline.trace import Trace
from schemas.dataset import DatasetVersion
from schemas.episode import Episode, Outcome, Segment
from schemas.finding import CheckVerdict, Finding
from schemas.hardcase import HardCase
from schemas.policy import PolicyRecord
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from schemas.release import Release
from schemas.scene import Draw, SceneSpec
from schemas.verdict import Proportion, StratumResult, Verdict
from stages.build import build

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


class Canary:
    """What is put into one episode in every form in which a store holds things, and how it is found again."""

    def __init__(self) -> None:
        rng = np.random.default_rng(20261124)
        self.bytes = rng.bytes(600)
        """Does not compress: stands verbatim in whatever holds it."""
        self.text = "Zaunkoenig-der-hier-nicht-bleiben-darf"
        self.row = rng.standard_normal(16).astype(np.float32)
        """A robot's state at one frame."""
        self.picture = np.kron(rng.integers(0, 2, (8, 8, 3)), np.ones((8, 8, 1))).astype(np.uint8) * 200 + 20
        """Blocks of colour, 64x64, that no compression hides."""

    def jpeg(self) -> bytes:
        return simplejpeg.encode_jpeg(self.picture, quality=85, colorspace="RGB")

    def in_bytes(self, data: bytes) -> set[str]:
        """Which forms of it stand in some bytes; pictures are taken out and looked at."""
        found = {name for name, form in (
            ("bytes", self.bytes), ("base64", base64.b64encode(self.bytes)[:700]), ("text", self.text.encode()),
            ("float32", self.row.tobytes()), ("float64", self.row.astype(np.float64).tobytes())) if form in data}
        for start in (m.start() for m in re.finditer(b"\xff\xd8\xff\xe0", data)):
            try:
                if self.looks(simplejpeg.decode_jpeg(data[start:start + 20_000], colorspace="RGB")):
                    found.add("jpeg")
            except ValueError:
                continue
        return found

    def looks(self, picture: np.ndarray) -> bool:
        """Whether a picture is the canary, after whatever compression."""
        same = picture.shape == self.picture.shape
        return same and np.corrcoef(picture.ravel(), self.picture.ravel())[0, 1] > 0.8

    def found(self, root: Path) -> dict[str, set[str]]:
        """File -> forms of the canary, over every byte of every file of a store, packed or not."""
        places: dict[str, set[str]] = {}
        for path in sorted(p for p in root.rglob("*") if p.is_file()):
            data = path.read_bytes()
            forms = self.in_bytes(data)
            for part in re.findall(rb"base64,([A-Za-z0-9+/=]+)", data):
                forms |= self.in_bytes(base64.b64decode(part))
            for inner in unpacked(path, data):
                forms |= self.in_bytes(inner)
            if data[4:8] == b"ftyp" and any(map(self.looks, decoded(path))):
                forms.add("video")
            if forms:
                places[str(path.relative_to(root))] = forms
        return places


def unpacked(path: Path, data: bytes) -> Iterator[bytes]:
    """What lies packed in a file: columns of tables, messages and attachments of recordings."""
    if data.startswith(b"PAR1"):
        for column in pq.read_table(path).columns:
            for chunk in column.chunks:
                yield from (b.to_pybytes() for b in chunk.buffers() if b is not None)
    elif data.startswith(b"ARROW1"):
        for column in pa.ipc.open_file(path).read_all().columns:
            for chunk in column.chunks:
                yield from (b.to_pybytes() for b in chunk.buffers() if b is not None)
    elif data.startswith(b"\x89MCAP0\r\n"):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            yield from (message.data for *_, message in reader.iter_messages())
            yield from (a.data for a in reader.iter_attachments())
            yield from (str(m.metadata).encode() for m in reader.iter_metadata())


class Film:
    """What a camera saw: one picture for every frame; see pipeline.footage.Footage."""

    def __init__(self, blob: str, frames: int, picture: np.ndarray) -> None:
        self.source = source_of(blob, np.zeros(frames, np.int64))
        self.skew_s, self.repeated, self._picture = np.zeros(frames, np.float32), 0, picture

    def pictures(self) -> Iterator[np.ndarray]:
        for _ in range(len(self.skew_s)):
            yield self._picture


@dataclass
class Lived:
    """A store in which a canary went through every stage, and what has it."""

    root: Path
    canary: Canary
    demo: str = ""
    policy: str = ""
    version: str = ""
    later: str = ""
    """A version that grew from the first, with a camera."""
    spared: tuple[str, ...] = ()
    """Variants of another demonstration, in the same shard as the canary's."""

    def table(self, version: str) -> pa.Table:
        return pq.read_table(self.root / "versions" / version / "data/chunk-000/file-000.parquet")


@pytest.fixture
def canary() -> Canary:
    return Canary()


@pytest.fixture
def live(small: Small, canary: Canary) -> Callable[[Path], Lived]:
    """Makes such a store in a folder."""
    return lambda root: lived_in(root, small, canary)


def frames_like(seed: int, canary: Canary | None) -> Frames:
    rng = np.random.default_rng(seed)
    frames = Frames(*(rng.standard_normal((10, len(names))).astype(np.float32) for names in FEATURES.values()))
    if canary is not None:
        frames.state[4] = canary.row
    return frames


def write_recording(path: Path, episode: Episode, frames: Frames, canary: Canary | None) -> bytes:
    """A recording whose attachment is the canary, too."""
    m, rng = len(frames), np.random.default_rng(1)
    trace = Trace(
        hz=20.0, state=frames.state, environment=frames.environment, action=frames.action,
        joint_action=frames.joint_action, joint_velocity=rng.random((m, 7)), joint_effort=rng.random((m, 7)),
        links=("base", "object"), link_poses=rng.random((m, 2, 7)), phase=("reach",) * m,
        reward={"reach": rng.random(m)}, sim_state=rng.random((m, 20)), controller=rng.random((m, 5)), shadows={},
        events=())
    extra = {"canary.bin": canary.bytes, "canary.jpeg": canary.jpeg()} if canary else {}
    write_episode(path, episode, trace, fsync=False,
                  attachments={"scene.xml": b"<mujoco/>", "robot.urdf": b"<robot name='arm'/>", "config.json": b"{}",
                               "randomization.json": b"[]", **extra})
    data = path.read_bytes()
    path.unlink()
    return data


def lived_in(root: Path, small: Small, canary: Canary) -> Lived:
    lived = Lived(root, canary)
    with Store.open(root, create=True) as store, store.lease(small.run) as lease:
        frames: dict[str, Frames] = {}

        def recorded(k: int, marked: bool, **change: object) -> Episode:
            e = small.episode(k, **change)
            frames[e.id] = frames_like(k, canary if marked else None)
            data = write_recording(store.tmp / "one.mcap", e, frames[e.id], canary if marked else None)
            return e.model_copy(update={"blob": store.put_blob(data)})

        told = {"label": "success", "judged_by": "operator", "reason": canary.text}
        demos = [recorded(k, k == 1, **({"outcome": told} if k == 1 else {})) for k in range(4)]
        lived.demo = demos[1].id
        variants = [small.variant(100 + k, of=demos[k % 3]) for k in range(6)]
        variants.append(small.variant(110, of=demos[0]).model_copy(
            update={"id": short_id("near"), "transform": f"retarget near {demos[1].id}"}))
        for k, v in enumerate(variants):
            frames[v.id] = frames_like(100 + k, canary if v.parent == demos[1].id or k == 6 else None)
        write_shard(store.tmp / "shard.arrow", {v.id: frames[v.id] for v in variants})
        shard = store.put_blob(store.tmp / "shard.arrow", move=True)
        variants = [v.model_copy(update={"blob": shard}) for v in variants]
        lived.spared = tuple(v.id for v in variants[:6] if v.parent != demos[1].id)
        recipe = Recipe(name="smoke", dataset=DatasetConfig(held_out=0.0, weights={"base": 0.5, "corrections": 0.5}))
        first = build([*demos, *variants], frames, recipe, store=root, task="pick", generation=0)
        policy = small.policy(first)
        (store.root / policy.checkpoint).mkdir(parents=True)
        (store.root / policy.checkpoint / "policy.onnx").write_bytes(f"onnx {policy.id}".encode())
        fails = {"label": "failure", "judged_by": "sensors", "trigger": "stall", "tick": 7}
        attempt = recorded(300, True, id=short_id("attempt"), origin="deployed", policy=policy.id, outcome=fails)
        mended = recorded(301, True, id=short_id("mended"), origin="corrected", parent=attempt.id, policy=policy.id,
                          transform="correction", generation=0,
                          segments=[{"kind": "autonomous", "start": 0, "stop": 5, "actor": policy.id},
                                    {"kind": "intervention", "start": 5, "stop": 10, "actor": "stand-in"}])
        shown = {demos[1].id: canary.picture}
        grey = {e.id: np.full((64, 64, 3), 40 + 3 * k, np.uint8) for k, e in enumerate([*demos, *variants, mended])}
        filmed = recipe.model_copy(update={"dataset": recipe.dataset.model_copy(
            update={"cameras": {"front": CameraConfig()}})})
        later = build([*demos, attempt, mended], frames, filmed, store=root, task="pick", generation=1,
                      footage=lambda e, c: Film(str(e.blob), e.frames, shown.get(e.id, grey.get(e.id))))
        with store.commit(lease) as tx:
            tx.add_run(small.info())
            tx.add_episodes([*demos, *variants])
            tx.finish_step(0, "collect", outputs={"ids": [d.id for d in demos]}, code=CODE)
            tx.add_version(first)
            tx.add_policy(policy)
            tx.add_verdict(small.verdict(policy))
            tx.add_release(small.release(1, policy, verdict=small.verdict(policy).id, kind="bootstrap"))
            tx.add_episodes([attempt, mended])
            tx.add_hard_cases([small.hard_case(attempt, correction=mended.id, corrected=True)])
            tx.add_version(later)
        store.add_check(CheckVerdict(
            id=short_id("check"), subject=str(demos[1].blob), kind="recording", name=demos[1].id, contract=CODE,
            code=CODE, passed=False, checks=("gaps",), skipped={},
            findings=(Finding(check="gaps", what=canary.text, where="/joint_states", mend="drop it"),)))
        whole = store.blob(str(demos[1].blob)).read_bytes()
    lived.policy, lived.version, lived.later = policy.id, first.id, later.id
    picture = base64.b64encode(canary.jpeg()).decode()
    for name, data in {
            f"reports/{small.run}.html": f'<img src="data:image/jpeg;base64,{picture}">'.encode(),
            "reports/other.html": f"<p>episode {lived.demo}, {base64.b64encode(canary.bytes).decode()}</p>".encode(),
            f"browse/{lived.demo}.base.0.rrd": canary.bytes, "caches/frames/x.npy": canary.picture.tobytes(),
            "recordings/left.mcap": whole, "tmp/version-half/data.parquet": canary.row.tobytes(),
            "tmp/tmpabc": b"half" + whole[:900] + canary.bytes}.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)
    return lived
