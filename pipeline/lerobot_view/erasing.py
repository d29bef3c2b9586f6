"""Takes episodes out of a version folder that stands: what is left is a whole LeRobot dataset under the same name.

A version never changes otherwise. Its id stays, because policies were trained on it; its manifest says what it lost.
"""

import json
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import JsonValue

from pipeline.arrow import read_parquet, to_rows
from pipeline.files import sync_folder
from pipeline.frames import Features, FeatureTable
from pipeline.lerobot_view.agreement import features_in
from pipeline.lerobot_view.layout import EPISODES, INFO, MANIFEST, data_file, file_number
from pipeline.lerobot_view.manifest import load_version, read_manifest
from pipeline.lerobot_view.split import chances, shares
from pipeline.lerobot_view.tables import Row
from pipeline.lerobot_view.writer import write_version
from schemas.dataset import DatasetVersion
from schemas.episode import Episode

OLD = ".old"
COLUMNS = ("episode_id", "tasks", "lineage", "split", "group", "consents")


@dataclass(frozen=True, slots=True)
class Loss:
    """What a version loses."""

    episodes: frozenset[str]
    """Ids of episodes, whether it held them or not."""
    hashes: frozenset[str]
    """Of files that go, wherever the manifest names them."""


def erase(folder: Path, loss: Loss, known: Mapping[str, Episode], aside: Path,
          parent: Path | None = None) -> DatasetVersion:
    """Take episodes out of a version, or find that they are out; a killed call is finished by the next.

    The new folder is built aside from what the old one holds and then takes its name. It shares data files with its
    parent, as a build does; without one it keeps its own before the first lost episode.

    Args:
        folder: the version.
        loss: what goes.
        known: id -> episode, of those that stay, their blobs as they will be.
        aside: a folder for unfinished things, on the same file system; this call alone uses it.
        parent: folder of the version that this one grew from, if that has lost the same episodes already.

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
    lost = [e for e in version.episodes if e in loss.episodes]
    if lost:
        aside.mkdir(parents=True, exist_ok=True)
        _rewrite(folder, new, version, loss, known, parent if parent and (parent / EPISODES).is_file() else folder)
        folder.rename(old)
        new.rename(folder)
        sync_folder(folder.parent)
        version = load_version(folder)
    shutil.rmtree(old, ignore_errors=True)
    return version


def _rewrite(folder: Path, new: Path, version: DatasetVersion, loss: Loss, known: Mapping[str, Episode],
             shared: Path) -> None:
    manifest = {k: _without(v, loss.hashes) for k, v in read_manifest(folder).items() if k not in ("files", "version")}
    kept = [e for e in version.episodes if e not in loss.episodes]
    rows, weights = _rows(folder, kept, known, version.weights)
    blobs = [known[e].blob for e in kept]
    now = version.model_copy(update={
        "episodes": tuple(kept), "held_out": tuple(e for e in version.held_out if e in set(kept)), "weights": weights,
        "inputs": tuple(dict.fromkeys(b for b in blobs if b)), "frames": sum(known[e].frames for e in kept),
        "erased": (*version.erased, *(e for e in version.episodes if e in loss.episodes))})
    content: dict[str, object] = {**manifest, "version": now.model_dump(mode="json", exclude={"digest"})}
    if not rows:
        return _empty(new, content)
    info: dict[str, Any] = json.loads((folder / INFO).read_text(encoding="utf-8"))
    frames = _Frames(folder)
    write_version(new, rows, lambda e: frames.of(e.id), content, aside=new.parent, fps=int(info["fps"]),
                  robot=str(info["robot_type"]), parent=shared, of=frames.features)


def _rows(folder: Path, kept: Collection[str], known: Mapping[str, Episode],
          weights: Mapping[str, float]) -> tuple[list[Row], dict[str, float]]:
    """The rows that stay, and the shares of the groups that are left, which add up to 1 again."""
    table = read_parquet(folder / EPISODES)
    said: dict[str, dict[str, Any]] = {line["episode_id"]: line for line in table.select(COLUMNS).to_pylist()}
    train = [known[e] for e in kept if said[e]["split"] == "train"]
    group = {e: str(said[e]["group"]) for e in kept}
    share = shares(weights, {group[e.id] for e in train})
    chance = chances(train, group, share)
    return [Row(known[e], said[e]["tasks"][0], said[e]["lineage"], said[e]["split"], said[e]["group"],
                chance.get(e, 0.0), said[e]["consents"] or "") for e in kept], share


class _Frames:
    """Frames of the episodes of a version, read from its data files."""

    def __init__(self, folder: Path) -> None:
        self.features: Features = features_in(folder)
        self._folder, self._number, self._columns = folder, -1, dict[str, Any]()
        table = read_parquet(folder / EPISODES, ["episode_id", "data/chunk_index", "data/file_index",
                                                 "dataset_from_index", "dataset_to_index"])
        lines = list(zip(*(table.column(k).to_pylist() for k in range(table.num_columns)), strict=True))
        self._places = {id: (file_number(chunk, file), start, stop) for id, chunk, file, start, stop in lines}
        self._first: dict[int, int] = {}
        for number, start, _ in self._places.values():
            self._first[number] = min(start, self._first.get(number, start))

    def of(self, episode: str) -> FeatureTable:
        """The frames of an episode; a file is read once for episodes in order."""
        number, start, stop = self._places[episode]
        if number != self._number:
            table = read_parquet(self._folder / data_file(number), [*self.features])
            self._columns = {name: to_rows(table.column(name), len(names)) for name, names in self.features.items()}
            self._number = number
        first = self._first[number]
        return FeatureTable(self.features, {name: rows[start - first:stop - first]
                                            for name, rows in self._columns.items()})


def _empty(new: Path, content: Mapping[str, object]) -> None:
    """What is left of a version that lost every episode: a manifest that says so."""
    path = new / MANIFEST
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({**content, "files": {}}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    path.chmod(0o444)
    with path.open("rb") as stream:
        os.fsync(stream.fileno())
    sync_folder(path.parent)
    sync_folder(new)


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
