"""Build: episodes and a recipe become an immutable dataset version.

Episodes of the parent keep their order and come first; those that also keep their place share its files and are not
read again. The id follows from the recipe, the episodes, the parent and the code, so that a build which was killed and
started again ends in the same version.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import get_args

from pipeline.check.door import NO_VERDICTS, Verdicts
from pipeline.consent import NO_CONSENTS, Consents, needs
from pipeline.errors import ConfigError, DatasetError
from pipeline.files import short_id, source_hash
from pipeline.footage import FootageOf
from pipeline.frames import FEATURES, Features, Table
from pipeline.lerobot_view import manifest, split, writer
from pipeline.lerobot_view.agreement import features_in, refuse_others
from pipeline.lerobot_view.filmed import Filmed, once, skews, with_skews
from pipeline.lerobot_view.manifest import load_version
from pipeline.lerobot_view.tables import Row
from schemas.dataset import DatasetVersion
from schemas.episode import VARIANTS, Episode, Origin
from schemas.recipe import CameraConfig, Recipe

__all__ = ["build", "code_hash", "load_version"]

ORIGINS: tuple[str, ...] = get_args(Origin.__value__)

READING = tuple(f"pipeline/recording/{name}.py" for name in (
    "cdr", "decode", "dialect", "errors", "fields", "legged", "live_header", "metadata", "read", "records", "scan",
    "series", "strings", "summary", "unpacking"))
"""What reads frames from a recording. Whatever else lies beside it, the recorder of live robots for one, turns
no recording into other bytes of a version, and must not change the ids of versions."""

GROUND = tuple(f"pipeline/{name}.py" for name in ("arrow", "footage", "frames", "shards", "trace"))
VIEW = tuple(f"pipeline/lerobot_view/{name}.py" for name in (
    "clips", "exact", "filmed", "layout", "manifest", "pixels", "sealing", "sharing", "split", "tables", "video",
    "writer"))
"""What lays frames and pictures into a version."""

FILMS = ("pipeline/recording/camera.py", "pipeline/logs/footage.py")
"""What reads pictures from a recording or an ingested log."""

FOLDER = "versions"
"""Where versions lie, relative to the store's root."""

NOTHING: Mapping[str, object] = MappingProxyType({})


def build(episodes: Sequence[Episode], frames_of: Callable[[Episode], Table] | Mapping[str, Table], recipe: Recipe,
          *, store: Path, task: str | Mapping[str, str], generation: int, parent: DatasetVersion | None = None,
          consents: Consents = NO_CONSENTS, verdicts: Verdicts = NO_VERDICTS, features: Features = FEATURES,
          footage: FootageOf | None = None, notes: Mapping[str, object] = NOTHING) -> DatasetVersion:
    """Make the dataset version that the recipe asks for, or return it if it is already there.

    Args:
        episodes: all that may enter; the parent's and ancestors among them, for they tell what belongs together.
        frames_of: gives the frames of an episode.
        recipe: its dataset section chooses; augment.keep_rejected lets failed variants pass.
        store: root of the store; the version becomes store/versions/ID.
        task: what the robot is asked to do, in words; one text for all episodes, or one for each id.
        generation: lap of the loop, from 0.
        parent: the version this one grows from.
        consents, verdicts: who agrees at this moment, and what the checks found; who or what does not is refused.
        features: of the robot; every episode and the parent must have these.
        footage: gives what a camera saw in an episode, for the cameras of the recipe; videos that were encoded once
            are found again below the store.
        notes: what else the manifest shall say.

    Raises:
        ConsentError: a person in an episode, or in one that it was made from, does not consent.
        DatasetError: nothing is left after the filter, an episode failed its check, has no recording or not the
            frames or features that it should, or the parent's folder is damaged.
        RecordingError: a frame that is not finite or has a wrong shape; names the episode.
        ConfigError: weights that do not fit the groups of episodes, or cameras that nothing was handed over for.
    """
    chosen = _in_order(_filtered(episodes, recipe), parent)
    consents.check(chosen, episodes)
    verdicts.check(chosen, episodes)
    code = code_hash()
    films = _films(recipe, footage)
    other = () if features is FEATURES and films is None else (_text(features), _text(notes))
    version = short_id(
        "dataset version", recipe.dataset.model_dump_json(), recipe.augment.keep_rejected, _text(task), generation,
        parent.id if parent else "", code, *other, *(e.model_dump_json() for e in chosen))
    facts = {"id": version, "generation": generation, "parent": parent.id if parent else None, "code": code}
    if not (target := store / FOLDER / version).exists():
        _write(target, chosen, episodes, recipe, task, parent, _getter(frames_of), features, facts, notes, films)
    return load_version(target)


def _write(target: Path, chosen: Sequence[Episode], everything: Sequence[Episode], recipe: Recipe,
           task: str | Mapping[str, str], parent: DatasetVersion | None, frames_of: Callable[[Episode], Table],
           features: Features, facts: Mapping[str, object], notes: Mapping[str, object],
           films: FootageOf | None) -> None:
    """Decide split and weights, then write the folder."""
    store = target.parents[1]
    fps, robot = _common(chosen)
    decided = split.Decided() if parent is None else _parent_decisions(store, parent)
    rows, held, weights = _rows(chosen, everything, recipe, task, decided)
    cameras, reuse, source = recipe.dataset.cameras, None, None
    if films is not None:
        features, frames_of = skews(features, cameras), with_skews(frames_of, cameras, films)
    if parent is not None and parent.code == facts["code"] and _cameras_of(store / parent.path) == cameras:
        reuse = _same_features(store / parent.path, features, robot)
    if films is not None:
        source = Filmed(cameras, films, store, fps, reuse)
    content = {**_content({**facts, "weights": weights}, rows, held, recipe, task, decided), **notes}
    writer.write_version(target, rows, frames_of, content, aside=store / "tmp", fps=fps, robot=robot, parent=reuse,
                         of=features, films=source)


def _content(facts: Mapping[str, object], rows: Sequence[Row], held: frozenset[str], recipe: Recipe,
             task: str | Mapping[str, str], decided: split.Decided) -> dict[str, object]:
    """What the manifest says of a version besides the digests of its files."""
    chosen = [row.episode for row in rows]
    train = {row.lineage for row in rows} - held
    return manifest.write_content(
        {
            **facts, "recipe": recipe.name, "path": f"{FOLDER}/{facts['id']}", "episodes": [e.id for e in chosen],
            "held_out": [row.episode.id for row in rows if row.split == "held_out"],
            "inputs": list(dict.fromkeys(e.blob for e in chosen)), "frames": sum(e.frames for e in chosen),
        },
        recipe=recipe.model_dump(mode="json"),
        task=task if isinstance(task, str) else sorted({row.task for row in rows}),
        lineages={"held_out": sorted(held | decided.held_out), "train": sorted(train | decided.train)},
    )


def code_hash() -> str:
    """Hash of every source file that decides which bytes a recording becomes."""
    here = Path(__file__)
    return source_hash([here, *(here.parents[1] / name for name in (*GROUND, *VIEW, *FILMS, *READING))])


def _films(recipe: Recipe, footage: FootageOf | None) -> FootageOf | None:
    """What gives the pictures, each asked for once; None where no camera is wanted."""
    if not recipe.dataset.cameras:
        return None
    if footage is None:
        raise ConfigError(f"no pictures of camera {next(iter(recipe.dataset.cameras))!r} were handed over",
                          where=f"recipe {recipe.name}: dataset.cameras",
                          mend="leave dataset.cameras out of the recipe")
    return once(footage)


def _cameras_of(folder: Path) -> Mapping[str, CameraConfig]:
    said = manifest.read_manifest(folder)["recipe"]["dataset"].get("cameras", {})
    return {name: CameraConfig.model_validate(camera) for name, camera in said.items()}


def _same_features(parent: Path, features: Features, robot: str) -> Path:
    refuse_others(features_in(parent), features, robot=robot, where=parent)
    return parent


def _text(value: object) -> str:
    """Plain text as it is, anything else as JSON in the order it is in."""
    return value if isinstance(value, str) else json.dumps(value, default=dict)


def _getter(frames_of: Callable[[Episode], Table] | Mapping[str, Table]) -> Callable[[Episode], Table]:
    def get(episode: Episode) -> Table:
        try:
            return frames_of(episode) if callable(frames_of) else frames_of[episode.id]
        except KeyError as error:
            raise DatasetError(f"the frames of episode {episode.id} are missing", where=f"episode {episode.id}",
                               mend="hand over the shard that its blob names") from error
    return get


def _filtered(episodes: Sequence[Episode], recipe: Recipe) -> list[Episode]:
    config = recipe.dataset
    for source in config.sources:
        if source not in ORIGINS:
            raise ConfigError(f"unknown source {source!r}", where="recipe: dataset.sources",
                              mend=f"use one of: {', '.join(sorted(ORIGINS))}")
    chosen: list[Episode] = []
    for episode in episodes:
        rejected_stay = recipe.augment.keep_rejected and episode.origin in VARIANTS
        wanted = not config.only_success or episode.outcome.label == "success" or rejected_stay
        if episode.origin in config.sources and wanted:
            chosen.append(_kept(episode))
    if len({e.id for e in chosen}) < len(chosen):
        twice = next(e.id for k, e in enumerate(chosen) if e.id in {c.id for c in chosen[:k]})
        raise DatasetError("an episode is there twice", where=f"episode {twice}", mend="hand over each episode once")
    if not chosen:
        raise DatasetError(f"none of {len(episodes)} episodes passes the filter", where=f"recipe {recipe.name}",
                           mend="widen dataset.sources, set dataset.only_success: false, or collect more: "
                                "hardcase collect")
    return chosen


def _kept(episode: Episode) -> Episode:
    if episode.blob is None:
        raise DatasetError(f"episode {episode.id} has no recording", where=f"episode {episode.id}",
                           mend="store its recording or shard first, or drop the episode")
    return episode


def _in_order(episodes: list[Episode], parent: DatasetVersion | None) -> list[Episode]:
    by_id = {e.id: e for e in episodes}
    first = [by_id.pop(i) for i in (parent.episodes if parent else ()) if i in by_id]
    return first + list(by_id.values())


def _common(episodes: Sequence[Episode]) -> tuple[int, str]:
    first = episodes[0]
    for episode in episodes:
        if (episode.control_hz, episode.scene.robot) != (first.control_hz, first.scene.robot):
            raise DatasetError(f"{episode.scene.robot!r} at {episode.control_hz:g} Hz beside {first.scene.robot!r} at "
                               f"{first.control_hz:g} Hz", where=f"episode {episode.id}",
                               mend="build one version for each robot and rate")
    if first.control_hz != int(first.control_hz):
        raise DatasetError(f"{first.control_hz:g} Hz is not a whole number, as LeRobot asks",
                           where=f"episode {first.id}", mend="record at a whole rate, such as 20 Hz")
    return int(first.control_hz), first.scene.robot


def _parent_decisions(store: Path, parent: DatasetVersion) -> split.Decided:
    folder = store / parent.path
    if load_version(folder).digest != parent.digest:
        raise DatasetError(f"version {parent.id} does not hold the bytes it was catalogued with", where=folder,
                           mend=f"remove the folder and build it again: rm -r {folder} && hardcase build")
    known = manifest.read_manifest(folder)["lineages"]
    held = frozenset((*parent.held_out, *known["held_out"]))
    return split.Decided(held, frozenset((*parent.episodes, *known["train"])) - held)


def _rows(chosen: Sequence[Episode], everything: Sequence[Episode], recipe: Recipe, task: str | Mapping[str, str],
          decided: split.Decided) -> tuple[list[Row], frozenset[str], dict[str, float]]:
    every = split.lineages(everything)
    roots = {e.id: every[e.id] for e in chosen}
    held = split.held_out(roots, recipe.dataset.held_out, decided, split.starts(everything))
    train = [e for e in chosen if roots[e.id] not in held]
    group = split.groups(chosen, {e.id: e for e in everything})
    weights = split.shares(recipe.dataset.weights, {group[e.id] for e in train})
    chance = split.chances(train, group, weights)
    people = needs(chosen, everything)
    rows = [Row(e, task if isinstance(task, str) else task[e.id], roots[e.id],
                "train" if e.id in chance else "held_out", group[e.id], chance.get(e.id, 0.0), ",".join(people[e.id]))
            for e in chosen]
    return rows, held, weights
