"""Importing: the episodes of a foreign LeRobot dataset become episodes of ours, each known again by what it holds."""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import cast

import numpy as np

from pipeline.arrow import pa, to_arrow
from pipeline.errors import DatasetError
from pipeline.files import short_id
from pipeline.lerobot_view.foreign import Foreign
from pipeline.lerobot_view.split import DRAWN
from schemas.consent import Consent
from schemas.episode import Episode, Outcome, Segment
from schemas.scene import SceneSpec

TAKE_OUT = "take one out: lerobot-edit-dataset, delete_episodes"


def identified(foreign: Foreign, videos: Mapping[tuple[int, str], str]) -> list[str]:
    """The id of every episode: it follows from what the episode holds, whatever file it lies in and at which place.

    Args:
        foreign: the dataset.
        videos: (episode, camera) -> digest of its pictures.

    Raises:
        DatasetError: two episodes hold the same.
    """
    ids = [_id(foreign, k, videos) for k in range(len(foreign))]
    if len(set(ids)) < len(ids):
        twice = next(k for k, id in enumerate(ids) if id in ids[:k])
        raise DatasetError(f"episode {twice} is there twice", where=foreign.folder, mend=TAKE_OUT)
    return ids


def imported(foreign: Foreign, ids: Sequence[str], consent: Consent, *, known: Mapping[str, Episode],
             keep: Callable[[Iterable[bytes]], Sequence[str]]) -> list[Episode]:
    """The episodes of a foreign dataset, in its order; those that are known stay as they are.

    Args:
        foreign: the dataset.
        ids: from `identified`.
        consent: the record of whoever drove the robot.
        known: episodes that are stored already, by id.
        keep: stores the frames of the new ones, an Arrow file each, and gives the hashes of these files.
    """
    new = [k for k, id in enumerate(ids) if id not in known]
    blobs = dict(zip(new, keep(_frames_file(foreign, k) for k in new), strict=True))
    return [known[id] if id in known else _episode(foreign, k, id, blobs[k], consent) for k, id in enumerate(ids)]


def slug(text: str) -> str:
    """A text as a name: lower case, digits, - and _; at most 64 of them."""
    return re.sub(r"[^a-z0-9_]+", "-", text.lower()).strip("-_")[:64].strip("-_") or "imported"


def _id(foreign: Foreign, k: int, videos: Mapping[tuple[int, str], str]) -> str:
    digest = hashlib.sha256()
    for name, rows in foreign.frames(k).items():
        digest.update(name.encode() + b"\0" + rows.tobytes())
    seen = [f"{camera} {pictures}" for (at, camera), pictures in videos.items() if at == k]
    return short_id("imported", foreign.fps, foreign.info.get("robot_type"), json.dumps(foreign.features, default=list),
                    foreign.task(k), foreign.label(k), digest.hexdigest(), *seen)


def _frames_file(foreign: Foreign, k: int) -> bytes:
    """The frames of one episode as an Arrow file of its own."""
    table = pa.table({name: to_arrow(rows) for name, rows in foreign.frames(k).items()})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)
    return cast(bytes, sink.getvalue().to_pybytes())


def _episode(foreign: Foreign, k: int, id: str, blob: str, consent: Consent) -> Episode:
    length = int(foreign.episodes["length"][k])
    over = foreign.taken_over(k)
    edges = [0, *(np.flatnonzero(np.diff(over.astype(np.int8))) + 1).tolist(), length]
    kinds = {True: "intervention", False: "autonomous" if over.any() else "demonstration"}
    segments = [Segment.model_validate({"kind": kinds[bool(over[a])], "start": a, "stop": b, "actor": consent.operator})
                for a, b in pairwise(edges)]
    scene = SceneSpec(family="foreign", seed=DRAWN + int(id, 16) % DRAWN,
                      robot=slug(str(foreign.info.get("robot_type") or "unknown")), scene="elsewhere",
                      task=slug(foreign.task(k)), stratum="foreign", object_xy_m=(0, 0), object_yaw_rad=0,
                      object_half_m=0, target_xy_m=(0, 0))
    label = foreign.label(k)
    return Episode(id=id, origin="imported", scene=scene, control_hz=foreign.fps, frames=length, generation=0,
                   outcome=Outcome.model_validate({"label": label, "judged_by": "sensors"}), segments=tuple(segments),
                   blob=blob, consent=consent.id)
