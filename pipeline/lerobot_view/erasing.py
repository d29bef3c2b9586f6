"""Takes episodes out of a version folder that stands: what is left is a whole LeRobot dataset under the same name.

A version never changes otherwise. Its id stays, because policies were trained on it; its manifest says what it lost.
"""

import json
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import JsonValue

from pipeline.arrow import texts
from pipeline.errors import DatasetError
from pipeline.files import sync_folder
from pipeline.lerobot_view.deriving import clips_of, write_derived
from pipeline.lerobot_view.draft import Draft
from pipeline.lerobot_view.incomplete import CURRICULUM
from pipeline.lerobot_view.manifest import load_version, read_manifest
from pipeline.lerobot_view.opened import Opened, open_version
from pipeline.lerobot_view.plan import Plan, planned
from pipeline.lerobot_view.sealing import building, seal, write_manifest
from schemas.dataset import DatasetVersion

OLD = ".old"


@dataclass(frozen=True, slots=True)
class Loss:
    """What a version loses."""

    episodes: frozenset[str]
    """Ids of episodes, whether it held them or not."""
    hashes: frozenset[str]
    """Of files that go, wherever the manifest names them."""
    moved: Mapping[str, str]
    """Hash of a file that is written anew without the episodes -> its hash from now on."""


type Resign = Callable[[Path, Mapping[str, str], Mapping[str, Any], Path], None]
"""Writes what a version says under a signature anew: new folder, known digests, manifest, old folder."""


def _unsigned(*_: object) -> None:
    """Nothing was signed."""


def erase(folder: Path, loss: Loss, aside: Path, resign: Resign = _unsigned) -> DatasetVersion:
    """Take episodes out of a version, or find that they are out; a killed call is finished by the next.

    The new folder is built aside from what the old one holds and then takes its name. Data files before the first
    lost episode, and all videos that stay, are shared with the old one, which is deleted.

    Args:
        folder: the version.
        loss: what goes.
        aside: a folder for unfinished things, on the same file system; this call alone uses it.
        resign: called when the new folder is whole but for its manifest.

    Returns:
        The version as it is now, its digest taken from the bytes.

    Raises:
        DatasetError: it is no version, or was changed after it was built.
    """
    old, new = aside / f"{folder.name}{OLD}", aside / folder.name
    if old.exists() and not folder.exists():  # killed between the two renames
        old.rename(folder)
    shutil.rmtree(new, ignore_errors=True)
    version = load_version(folder)
    if not loss.episodes.isdisjoint(version.episodes):
        aside.mkdir(parents=True, exist_ok=True)
        if (folder / CURRICULUM).is_file():
            from pipeline.locomotion.lesson import write_without

            write_without(new, folder, loss.episodes, loss.hashes)
        else:
            _write(new, _with_hashes(open_version(folder, version), loss), loss, resign)
        folder.rename(old)
        new.rename(folder)
        sync_folder(folder.parent)
        version = load_version(folder)
    shutil.rmtree(old, ignore_errors=True)
    return version


def lost_videos(folder: Path, hashes: Collection[str]) -> Iterator[Path]:
    """Encoded videos of a store that no version has a link to, and the notes on them or on lost files; see clips.py.

    After an erasure those of its episodes are among them. What is taken too much is encoded again when it is needed.
    """
    videos = sorted(folder.glob("*.mp4"))
    lost = {file.stem for file in videos if file.stat().st_nlink == 1}
    for note in sorted(folder.glob("*.json")):
        try:
            told: dict[str, Any] = json.loads(note.read_bytes())
            names = {*str(told["source"]).split(), str(told["sha256"])}
        except (ValueError, KeyError, TypeError):
            names = set(hashes)
        if not names.isdisjoint({*hashes, *lost}):
            yield note
    yield from (file for file in videos if file.stem in lost)
    yield from sorted(folder.glob(".*"))


def _with_hashes(opened: Opened, loss: Loss) -> Opened:
    """The version with the hashes that its shards will have."""
    table = opened.episodes
    blobs = [loss.moved.get(str(b), b) for b in opened.texts("blob")]
    place = table.schema.get_field_index("blob")
    return replace(opened, episodes=table.set_column(place, "blob", texts(blobs))) if place >= 0 else opened


def _write(new: Path, opened: Opened, loss: Loss, resign: Resign) -> None:
    draft = Draft.of(opened)
    draft = draft.kept(np.array([id not in loss.episodes for id in draft.ids], np.bool_))
    if "train" not in draft.gathered("split"):  # nothing that is left could teach anything
        with building(new, new.parent) as folder:
            (folder / "meta").mkdir()
            write_manifest(folder, _content(opened, None, loss), {})
            seal(folder)
        return
    made = planned(draft)
    clips = clips_of(made)
    kept = {clip.sha256 for many in clips.values() for clip in many}
    gone = {sha for name, sha in opened.hashes.items() if name.startswith("videos/")} - kept
    wider = Loss(loss.episodes, loss.hashes | gone, loss.moved)
    content = _content(opened, made, wider)
    write_derived(new, made, content, aside=new.parent, clips=clips,
                  last=lambda part, known: resign(part, known, content, opened.folder))


def _content(opened: Opened, made: Plan | None, loss: Loss) -> dict[str, object]:
    """What the manifest says: as before, with what is left and what is lost."""
    before = {name: _without(value, loss.hashes) for name, value in opened.manifest.items()
              if name not in ("files", "version")}
    version: dict[str, Any] = dict(opened.manifest["version"])
    lost = [id for id in version["episodes"] if id in loss.episodes]
    inputs = [loss.moved.get(sha, sha) for sha in version["inputs"] if sha in loss.moved or sha not in loss.hashes]
    now: dict[str, object] = {"episodes": [], "held_out": [], "inputs": [], "frames": 0} if made is None else {
        "episodes": made.ids, "held_out": [id for id in version["held_out"] if id not in loss.episodes],
        "inputs": inputs, "frames": made.frames, "weights": made.weighed.shares}
    return {**before, "version": {**version, **now, "erased": [*version.get("erased", ()), *lost]}}


def _without(value: JsonValue, hashes: Collection[str]) -> JsonValue:
    """JSON without the list items that name one of these hashes."""
    if isinstance(value, dict):
        return {k: _without(v, hashes) for k, v in value.items()}
    if isinstance(value, list):
        return [_without(v, hashes) for v in value if not _names(v, hashes)]
    return value


def _names(value: JsonValue, hashes: Collection[str]) -> bool:
    return value in hashes if isinstance(value, str) else isinstance(value, dict) and any(
        isinstance(v, str) and v in hashes for v in value.values())


def holds(folder: Path, episodes: Collection[str]) -> bool:
    """Whether a version folder that nobody knows holds one of these episodes, or cannot say."""
    try:
        return not set(read_manifest(folder)["version"]["episodes"]).isdisjoint(episodes)
    except (DatasetError, KeyError, TypeError):
        return True
