"""Real recordings of the nominal arm, ways to spoil them, and datasets made from them."""

import dataclasses
import json
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.records import Message

from pipeline.check.folder import read_folder
from pipeline.check.load import read_recording
from pipeline.check.projection import scene_poses
from pipeline.check.run import check
from pipeline.consent import NO_CONSENTS
from pipeline.recording import read_attachments, read_episode, read_frames, write_episode
from pipeline.recording.dialect import EPOCH_NS
from pipeline.recording.live import LiveRecorder
from pipeline.recording.live_rows import Row
from schemas.contract import Contract
from schemas.finding import CheckVerdict
from schemas.recipe import CollectConfig, DatasetConfig, Recipe
from stages.build import build
from stages.collect import collect

DEMONSTRATIONS = 6
WIDTH, HEIGHT = 64, 48


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    return Recipe(name="tests", collect=CollectConfig(demonstrations=DEMONSTRATIONS),
                  dataset=DatasetConfig(sources=("scripted",), weights={"base": 1.0}, held_out=0.3))


@pytest.fixture(scope="session")
def demos(recipe, tmp_path_factory) -> list[Path]:
    """Recorded demonstrations of the scripted expert."""
    recorded = collect(recipe, seed=11, folder=tmp_path_factory.mktemp("demos"), software={"software_commit": "tests"})
    return [r.path for r in recorded]


@pytest.fixture(scope="session")
def findings() -> Callable[..., CheckVerdict]:
    """Checks one file or folder."""

    def found(path: Path, contract: Contract | None = None) -> CheckVerdict:
        subject = read_folder(path) if path.is_dir() else read_recording(path)
        return check(subject, contract or Contract())

    return found


@pytest.fixture(scope="session")
def names() -> Callable[[CheckVerdict], set[str]]:
    """The checks that found something."""
    return lambda verdict: {f.check for f in verdict.findings}


@pytest.fixture
def spoil_trace(demos, tmp_path):
    """Writes the first demonstration again with arrays of its trace, or fields of its episode, changed."""

    def spoiled(change: Callable[[SimpleNamespace], None], k: int = 0) -> Path:
        episode, trace = read_episode(demos[k])
        arrays = {f.name: getattr(trace, f.name) for f in dataclasses.fields(trace)}
        copy = SimpleNamespace(**{n: v.copy() if isinstance(v, np.ndarray) else v for n, v in arrays.items()},
                               episode=episode.model_copy(update={"blob": None}))
        change(copy)
        changed = dataclasses.replace(trace, **{name: getattr(copy, name) for name in arrays})
        path = tmp_path / "spoiled.mcap"
        write_episode(path, copy.episode, changed, attachments=read_attachments(demos[k]))
        return path

    return spoiled


type Change = Callable[[str, Message], Iterable[Message]]


@pytest.fixture
def spoil_messages(demos, tmp_path, rewritten):
    """Writes a demonstration again, each message passed through `change`."""

    def spoiled(change: Change, k: int = 0) -> Path:
        path = tmp_path / "spoiled.mcap"
        path.write_bytes(rewritten(demos[k].read_bytes(), change))
        return path

    return spoiled


@pytest.fixture
def spoil_film(tmp_path, rewritten):
    """Writes a film again, each message passed through `change`."""

    def spoiled(film: Path, change: Change) -> Path:
        path = tmp_path / "spoiled.mcap"
        path.write_bytes(rewritten(film.read_bytes(), change))
        return path

    return spoiled


def seconds(message: Message) -> float:
    """Log time from the recording's start [s]."""
    return (message.log_time - EPOCH_NS) / 1e9


@pytest.fixture(scope="session")
def at_s() -> Callable[[Message], float]:
    return seconds


@pytest.fixture(scope="session")
def drawn(demos) -> Callable[[int], tuple[dict[str, np.ndarray], dict[str, bytes]]]:
    """Pictures of the two cameras of the scene, drawn rather than rendered: an arm where each would see it."""

    def pictures(k: int) -> dict[str, np.ndarray]:
        _, trace = read_episode(demos[k])
        poses = scene_poses(read_attachments(demos[k])["scene.xml"])
        found: dict[str, np.ndarray] = {}
        for n, (name, pose) in enumerate(sorted(poses.items())):
            rng = np.random.default_rng(n)
            ground = np.kron(rng.integers(60, 200, (6, 8)), np.ones((HEIGHT // 6, WIDTH // 8))).astype(np.uint8)
            frames = np.repeat(ground[None, :, :, None], len(trace), axis=0).repeat(3, axis=3)
            for share in np.linspace(0, 1, 12):  # an arm from the shoulder to the tool
                seen = pose.seen((1 - share) * np.array([0.0, 0.0, 0.4]) + share * trace.state[:, 7:10])
                for picture, (right, down) in zip(frames, seen, strict=True):
                    x, y = int(WIDTH / 2 + 62 * right), int(HEIGHT / 2 + 62 * down)
                    picture[max(0, y - 3):max(0, y + 3), max(0, x - 3):max(0, x + 3)] = (250, 40, 20)
            noise = rng.integers(-3, 4, frames.shape[:3])  # no sensor gives the same picture twice
            found[name] = np.clip(frames.astype(np.int16) + noise[..., None], 0, 255).astype(np.uint8)
        return found

    return pictures


@pytest.fixture
def film(demos, tmp_path):
    """Records the first demonstration live, with these pictures of each camera."""

    def filmed(pictures: dict[str, np.ndarray], k: int = 0, name: str = "filmed") -> Path:
        path = tmp_path / f"{name}.mcap"
        episode, t = read_episode(demos[k])
        now = [EPOCH_NS]
        recorder = LiveRecorder(path, episode.model_copy(update={"blob": None}), clock=lambda: now[0],
                                attachments=read_attachments(demos[k]), reserve_bytes=0)
        for tick in range(len(t)):
            now[0] = EPOCH_NS + tick * 50_000_000
            recorder.tick(tick, Row(t.state[tick], t.environment[tick], t.action[tick], t.joint_action[tick],
                                    t.joint_velocity[tick], t.joint_effort[tick]))
            for camera, frames in pictures.items():
                recorder.image(camera, frames[tick], tick=tick)
        recorder.close(episode.outcome, episode.segments)
        return path

    return filmed


@pytest.fixture(scope="session")
def version(demos, recipe, tmp_path_factory) -> Path:
    """A dataset version of the demonstrations, in a store of its own."""
    store = tmp_path_factory.mktemp("store")
    read = [read_frames(path) for path in demos]
    made = build([e for e, _ in read], {e.id: f for e, f in read}, recipe, store=store, task="pick", generation=0,
                 consents=NO_CONSENTS)
    return store / made.path


@pytest.fixture
def folder(version, tmp_path) -> Path:
    """A copy of the version that may be changed, as somebody else's dataset: without our manifest."""
    target = tmp_path / "dataset"
    shutil.copytree(version, target)
    for path in target.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    (target / "meta/hardcase.json").unlink()
    return target


@pytest.fixture
def edit_json() -> Callable[[Path, Callable[[dict], None]], None]:
    """Changes a JSON file in place."""

    def edit(path: Path, change: Callable[[dict], None]) -> None:
        path.chmod(0o644)
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return edit


@pytest.fixture
def edit_table():
    """Changes columns of a Parquet file in place, as lists of Python values."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def edit(path: Path, change: Callable[[dict[str, list]], None]) -> None:
        table = pq.read_table(path)
        columns = {name: table.column(name).to_pylist() for name in table.column_names}
        change(columns)
        kept = {n: pa.array(v, table.schema.field(n).type) if n in table.column_names else pa.array(v)
                for n, v in columns.items()}
        pq.write_table(pa.table(kept), path)

    return edit
