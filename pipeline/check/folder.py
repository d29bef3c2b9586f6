"""A LeRobot v3 folder, ours or anybody's, as the signals that checks read; no lerobot needed."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrow import pa, read_parquet, to_rows
from pipeline.check.films import MEND, film_cameras, pictures_there
from pipeline.check.fit import feature_names
from pipeline.check.signals import Column, Signals, Subject, Tables, Topic
from pipeline.errors import DatasetError, HardcaseError, one_line
from pipeline.files import sha256_file
from pipeline.lerobot_view.layout import BOOKKEEPING, INFO, MANIFEST, STATS, files_in
from pipeline.lerobot_view.manifest import load_version, read_manifest
from schemas.dataset import DatasetVersion

PICTURES = ("image", "video")
MAX_ROWS = 20_000_000
"""Rows above which a folder is refused rather than held in memory."""


def is_dataset(path: Path) -> bool:
    """Whether a path is a folder that calls itself a LeRobot dataset."""
    return (path / INFO).is_file()


def read_folder(folder: Path, *, name: str | None = None) -> Subject:
    """All tables and episodes of a dataset.

    Args:
        folder: holds meta/info.json.
        name: what it is called in findings; the folder's name by default.

    Raises:
        DatasetError: not a LeRobot v3 dataset, or a file of it is missing or damaged.
    """
    info = _json(folder, INFO)
    if str(info.get("codebase_version")) != "v3.0":
        raise DatasetError(f"a LeRobot dataset of format {info.get('codebase_version')!r}, v3.0 is read", where=folder,
                           mend="convert it: python -m lerobot.scripts.convert_dataset_v21_to_v30")
    if not isinstance(fps := info.get("fps"), int | float) or not fps > 0:
        raise DatasetError(f"{INFO} gives a rate of {fps!r}", where=folder, mend="write the frames a second there")
    try:
        episodes = _episodes(folder)
        frames = _frames(folder, info)
        tables = _tables(folder, info, episodes, frames)
        recordings = tuple(_recording(k, tables) for k in range(len(episodes["episode_index"])))
        cameras = film_cameras(folder, tables)
    except HardcaseError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise DatasetError(f"dataset is damaged: {one_line(error)[:200]}", where=folder, mend=MEND) from error
    called = name or (tables.version.id if tables.version else folder.resolve().name)
    recordings = tuple(replace(s, cameras=cameras.get(k, {})) for k, s in enumerate(recordings))
    return Subject(called, _digest(folder, tables.version), recordings, tables)


def _digest(folder: Path, version: DatasetVersion | None) -> str:
    if version is not None:
        return version.digest
    names = {p.relative_to(folder).as_posix(): p for p in files_in(folder)}
    return hashlib.sha256("".join(f"{n}\0{sha256_file(names[n])}\n" for n in sorted(names)).encode()).hexdigest()


def _json(folder: Path, name: str) -> dict[str, Any]:
    try:
        found: object = json.loads((folder / name).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DatasetError(f"{name} cannot be read", where=folder, mend=MEND) from error
    if not isinstance(found, dict):
        raise DatasetError(f"{name} holds no mapping", where=folder, mend=MEND)
    return found  # pyright: ignore[reportUnknownVariableType]


def _episodes(folder: Path) -> dict[str, list[Any]]:
    """Columns of the episodes table, statistics left out, in the order of episode_index."""
    columns: dict[str, list[Any]] = {}
    for path in sorted((folder / "meta/episodes").rglob("*.parquet")):
        table = read_parquet(path)
        for name in table.column_names:
            if not name.startswith("stats/"):
                columns.setdefault(name, []).extend(table.column(name).to_pylist())
    if not columns.get("episode_index") or len(columns.get("length", [])) != len(columns["episode_index"]):
        raise DatasetError("the table of episodes is missing or empty", where=folder / "meta/episodes", mend=MEND)
    return columns


def _frames(folder: Path, info: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Feature -> rows of every number feature, the data files joined in the order of their names."""
    features: dict[str, Any] = info["features"]
    wanted = {n: int(np.prod(f.get("shape") or [1])) for n, f in features.items()
              if f["dtype"] not in (*PICTURES, "string")}
    wanted |= {n: 1 for n in BOOKKEEPING}
    parts: dict[str, list[NDArray[Any]]] = {}
    for path in sorted((folder / "data").rglob("*.parquet")):
        table = read_parquet(path)
        for name, width in wanted.items():
            if name in table.column_names:
                parts.setdefault(name, []).append(_rows(table.column(name), width))
        if sum(map(len, parts.get("index", []))) > MAX_ROWS:
            raise DatasetError(f"more than {MAX_ROWS} rows", where=folder, mend="check it in parts")
    if not parts:
        raise DatasetError("there are no data files", where=folder / "data", mend=MEND)
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}


def _rows(column: Any, width: int) -> NDArray[Any]:
    """A column as rows; one with missing or nested values the slow way, missing ones as NaN."""
    try:
        return to_rows(column, width)
    except (ValueError, NotImplementedError):
        return np.array([_flat(v, width) for v in column.to_pylist()], np.float64).reshape(-1, width)


def _flat(value: Any, width: int) -> NDArray[np.float64]:
    flat = np.asarray(np.nan if value is None else value, np.float64).reshape(-1)
    return flat if flat.size == width else np.full(width, np.nan)


def _tables(folder: Path, info: Mapping[str, Any], episodes: Mapping[str, list[Any]],
            frames: Mapping[str, NDArray[Any]]) -> Tables:
    stats = _json(folder, STATS) if (folder / STATS).is_file() else {}
    version, manifest, damage = None, {}, ""
    if (folder / MANIFEST).is_file():
        try:
            manifest = read_manifest(folder)
            version = load_version(folder)
        except DatasetError as error:
            damage = error.what
    return Tables(info, stats, episodes, frames, pictures_there(folder, info, episodes), version, manifest, damage)


def _recording(k: int, tables: Tables) -> Signals:
    """Episode k as signals: every float feature is a topic with one unnamed field."""
    episodes, index = tables.episodes, int(tables.episodes["episode_index"][k])
    lengths = np.asarray(episodes["length"], np.int64)
    stop = int(lengths[:k + 1].sum())
    part = slice(stop - int(lengths[k]), stop)
    period_ns = 1e9 / float(tables.info["fps"])
    stamps = np.round(np.arange(int(lengths[k])) * period_ns).astype(np.int64)
    topics: dict[str, Topic] = {}
    for name, rows in tables.frames.items():
        names = feature_names(tables.info["features"], name)
        if name in BOOKKEEPING or names is None or rows.dtype.kind != "f":
            continue
        column = Column(rows[part].astype(np.float64), names)
        topics[name] = Topic(name, "", stamps[:len(column.rows)], stamps[:len(column.rows)], None, None, {"": column},
                             tabled=True)
    facts = {key: str(episodes[key][k]) for key in ("outcome", "episode_id", "source", "trigger", "consents", "parent")
             if key in episodes and episodes[key][k] is not None}
    return Signals(f"episode {index}", topics, metadata={"episode": facts}, index=index,
                   lineage=str(episodes["lineage"][k] or "") if "lineage" in episodes else "",
                   split=str(episodes["split"][k]) if "split" in episodes else _split(tables.info, k))


def _split(info: Mapping[str, Any], k: int) -> str:
    """The name of the split in info.json whose range 'a:b' holds an episode."""
    for name, bounds in info.get("splits", {}).items():
        first, _, last = str(bounds).partition(":")
        if first.isdigit() and last.isdigit() and int(first) <= k < int(last):
            return str(name)
    return ""
