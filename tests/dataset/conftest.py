"""Episodes of a tiny robot that never ran: legal records with arrays that differ in every value."""

import hashlib
from collections.abc import Callable

import numpy as np
import pytest

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


@pytest.fixture
def episode() -> Callable[..., Episode]:
    """Makes an Episode: episode(name, origin, length=, parent=name, label=, generation=, takeover=tick)."""
    return make_episode


@pytest.fixture
def frames() -> Callable[[Episode], Frames]:
    """Gives the frames of an episode made here; they follow from its id."""
    return frames_of


@pytest.fixture
def recipe() -> Recipe:
    """The default dataset section."""
    return Recipe(name="test")


@pytest.fixture
def task() -> str:
    return TASK
