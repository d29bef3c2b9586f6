"""Episodes of a tiny robot that never ran: legal records with arrays that differ in every value."""

import hashlib
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.frames import FEATURES, Frames
from schemas.episode import Episode, Outcome, Segment
from schemas.recipe import Recipe
from schemas.scene import SceneSpec

TASK = "pick up the cube and place it on the target"


def make_frames(seed: int, length: int) -> Frames:
    rng = np.random.default_rng(seed)
    return Frames(*(rng.standard_normal((length, len(names))).astype(np.float32) for names in FEATURES.values()))


def make_episode(name: str, origin: str = "scripted", *, length: int = 12, parent: str | None = None,
                 label: str = "success", generation: int = 0, takeover: int | None = None, **fields: object) -> Episode:
    def digest(text: str) -> str:
        return hashlib.sha256(text.encode()).hexdigest()

    cuts = [(0, takeover, "autonomous"), (takeover, length, "intervention")] if takeover else [
        (0, length, "demonstration")]
    return Episode.model_validate({
        "id": digest(name)[:16], "origin": origin,
        "scene": SceneSpec(family="demo", seed=1, robot="arm", scene="table", task="pick-place", stratum="common",
                           object_xy_m=(0.3, 0.0), object_yaw_rad=0.1, object_half_m=0.02, target_xy_m=(0.3, 0.1)),
        "control_hz": 20.0, "frames": length,
        "outcome": Outcome(label=label, judged_by="simulator", family=None if label == "success" else "dropped"),
        "segments": [Segment(kind=kind, start=a, stop=b, actor="expert") for a, b, kind in cuts],
        "parent": digest(parent)[:16] if parent else None, "transform": "replay" if parent else None,
        "generation": generation, "blob": digest("blob of " + name), **fields,
    })


def frames_of(episode: Episode) -> Frames:
    return make_frames(int(episode.id, 16), episode.frames)


class DrawnFootage:
    """What a made-up camera saw: a smooth picture that wanders, 64x48 unless the camera's name says otherwise."""

    def __init__(self, episode: Episode, camera: str) -> None:
        if camera == "gone":
            raise DatasetError("the recording has no picture of camera 'gone'", where=f"episode {episode.id}",
                               mend="leave the episode out")
        self._seed, self._camera = int(episode.id, 16), camera
        numbers = np.arange(3 if camera == "short" and episode.frames == 5 else episode.frames)
        self.uses = numbers // 3 * 3 if camera == "late" else numbers
        self.skew_s = ((numbers - self.uses) / 20).astype(np.float32)
        if camera == "short":
            self.skew_s = np.zeros(episode.frames, np.float32)
        self.source, self.repeated = f"{episode.blob} {camera}", int((np.diff(self.uses) == 0).sum())
        self._small = camera == "mixed" and episode.frames > 5

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        return (self._picture(k) for k in self.uses.tolist())

    def _picture(self, k: int) -> NDArray[np.uint8]:
        height, width = {"turned": (64, 48) if k == 2 else (48, 64), "odd": (49, 65)}.get(self._camera, (48, 64))
        if self._small:
            height, width = 32, 32
        y, x = np.mgrid[:height, :width]
        shift = self._seed % 397 + 3 * k + len(self._camera)
        waves = np.stack([x * 3 + shift, y * 4 + 2 * shift, x + y + shift], -1)
        return np.abs(waves % 400 - 200).astype(np.uint8)


def footage_of(episode: Episode, camera: str) -> DrawnFootage:
    return DrawnFootage(episode, camera)


@pytest.fixture(scope="session")
def footage() -> Callable[[Episode, str], DrawnFootage]:
    """Gives what a camera saw in an episode made here; see DrawnFootage."""
    return footage_of


@pytest.fixture(scope="session")
def episode() -> Callable[..., Episode]:
    """Makes an Episode: episode(name, origin, length=, parent=name, label=, generation=, takeover=tick)."""
    return make_episode


@pytest.fixture
def frames() -> Callable[[Episode], Frames]:
    """Gives the frames of an episode made here; they follow from its id."""
    return frames_of


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    """The default dataset section."""
    return Recipe(name="test")


@pytest.fixture(scope="session")
def task() -> str:
    return TASK


@pytest.fixture(scope="session")
def smooth() -> Callable[[Episode], Frames]:
    """Gives frames that a robot could have made: slow waves, two ticks behind their commands."""
    def frames(episode: Episode) -> Frames:
        rng, t = np.random.default_rng(int(episode.id, 16)), np.arange(episode.frames) / 20
        waves: dict[str, tuple[float, ...]] = {}

        def column(name: str, late_s: float) -> np.ndarray:
            at, height, speed, phase = waves.setdefault(name, tuple(rng.uniform([-1, 0.2, 1, 0], [1, 0.4, 3, 6])))
            return at + height * np.sin((t - late_s) * speed + phase)

        def value(feature: str, name: str) -> np.ndarray:
            kind, _, axis = name.partition("_")
            if kind == "cmd" and axis != "gripper":
                return column(axis, 0.0)
            if kind == "ee":
                return column(axis, 0.1)
            if name in ("dx", "dy", "dz", "dyaw"):  # from the next row on
                return column(name[1:], -0.05) - column(name[1:], 0.0)
            return column(name, 0.1 if feature == "observation.state" else 0.0)

        return Frames(*(np.stack([value(f, n) for n in names], axis=1).astype(np.float32)
                        for f, names in FEATURES.items()))
    return frames
