"""From traces to recordings: episode ids, attachments, files in a folder."""
# mujoco is a compiled package without type stubs: a compiled model has no type that a checker knows
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pipeline.files import short_id
from pipeline.recording import Recording, write_episodes
from pipeline.simulation.urdf import robot_urdf
from pipeline.trace import Trace
from schemas.episode import Episode, Origin
from schemas.scene import SceneSpec


@dataclass(frozen=True, slots=True)
class Recorded:
    """An episode and its MCAP file, not yet in the store."""

    episode: Episode
    path: Path


class Rooted(Protocol):
    """A robot's body."""

    @property
    def root(self) -> str:
        """The body that becomes the root of its URDF."""
        ...


class Recordable(Protocol):
    """Robot and scene: a Setup, or a LeggedSetup."""

    @property
    def body(self) -> Rooted:
        """The robot."""
        ...

    @property
    def model(self) -> Any:
        """A mujoco.MjModel."""
        ...

    @property
    def xml(self) -> str:
        """MJCF of the model."""
        ...


def episode_id(origin: Origin, scene: SceneSpec, *causes: object) -> str:
    """Id of a simulated episode: it follows from its causes, never from the clock."""
    return short_id("episode", origin, scene.model_dump_json(), *causes)


def record(folder: Path, setup: Recordable, episodes: Sequence[Episode], traces: Sequence[Trace], *,
           config: Mapping[str, object], software: Mapping[str, str]) -> list[Recorded]:
    """Write one MCAP file an episode and return the episodes with the hash of their file as blob.

    Args:
        folder: where to write; files are named by episode id.
        setup: robot and scene, attached as MJCF and URDF.
        episodes: records without blob.
        traces: what happened, in the same order.
        config: thresholds and sizes that were in force, attached as JSON.
        software: strings for the metadata record.
    """
    name = episodes[0].scene.robot if episodes else ""
    fixed = {"scene.xml": setup.xml.encode(), "robot.urdf": robot_urdf(setup.model, setup.body.root, name).encode(),
             "config.json": json.dumps(dict(config), sort_keys=True).encode()}
    items = [Recording(folder / f"{e.id}.mcap", e, t,
                       {**fixed, "randomization.json": json.dumps([d.model_dump() for d in e.scene.draws]).encode()},
                       software)
             for e, t in zip(episodes, traces, strict=True)]
    hashes = write_episodes(items)
    return [Recorded(item.episode.model_copy(update={"blob": h}), item.path)
            for item, h in zip(items, hashes, strict=True)]
