"""hardcase import: a foreign LeRobot dataset is checked, its episodes get ids by content and become a version."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flows.data.consents import consents_now
from flows.data.deriving import named_version
from pipeline.check.folder import is_dataset
from pipeline.errors import ConfigError, ConsentError, DatasetError, StoreError
from pipeline.frames import FeatureTable
from pipeline.lerobot_view.agreement import features_in, refuse_others
from pipeline.lerobot_view.clips import Clips
from pipeline.lerobot_view.foreign import MEND, Foreign, read_foreign
from pipeline.lerobot_view.foreign_video import ForeignFootage, footage_of, keep_copy, packets_of
from pipeline.lerobot_view.manifest import load_version
from pipeline.store import Store, store_root
from schemas.consent import NO_CONSENT, Consent
from schemas.contract import Contract
from schemas.dataset import DatasetVersion
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from stages.build import build
from stages.check import Item, check
from stages.importing import identified, imported, slug


@dataclass(frozen=True, slots=True)
class ImportOrder:
    """What is to be imported, as it was typed."""

    folder: Path
    consent: str | None = None
    weight: float | None = None
    """Share of every batch that the version gets when it is added to another."""
    name: str | None = None
    like: str | None = None
    """Version whose robot, rate and features it must have."""


def import_folder(order: ImportOrder, root: Path | None = None) -> dict[str, Any]:
    """Check a foreign dataset and make a version of it; the same folder twice adds nothing.

    Returns:
        version, episodes, frames, new (episodes that were not there before), copied and encoded (videos), warnings.

    Raises:
        HardcaseError: no dataset, one that fails its check, features that do not fit, or nobody's consent.
    """
    if order.weight is not None and not 0 < order.weight < 1:
        raise ConfigError(f"a share of {order.weight:g} is not between 0 and 1", where=f"--weight {order.weight:g}",
                          mend="give the share of every batch, such as --weight 0.3")
    if not is_dataset(order.folder):
        raise DatasetError("not a LeRobot dataset (no meta/info.json)", where=order.folder, mend=MEND)
    with Store.open(root or store_root(), create=True) as store:
        if (known := _ours(store, order.folder)) is not None:
            return _told(known, 0, 0, 0, ["it is an unchanged copy of a version of this store"])
        foreign = read_foreign(order.folder)
        if order.like is not None:
            _refuse_unlike(store, foreign, order.like)
        if not foreign.features:
            raise DatasetError("it has no feature of numbers", where=order.folder, mend=MEND)
        consent = _agreed(store, order.consent)
        warnings = _checked(order.folder)
        return _imported(store, foreign, order, consent, warnings)


def _ours(store: Store, folder: Path) -> DatasetVersion | None:
    """The version of this store that a folder is an unchanged copy of."""
    try:
        version = load_version(folder)
        there = store.version(version.id)
    except (DatasetError, StoreError):
        return None
    return there if there.digest == version.digest else None


def _refuse_unlike(store: Store, foreign: Foreign, like: str) -> None:
    version = named_version(store, like, f"--like {like}")
    of = store.path(version.path)
    info = json.loads((of / "meta/info.json").read_text(encoding="utf-8"))
    for key, called in (("robot_type", "robot"), ("fps", "rate")):
        if info[key] != foreign.info.get(key):
            raise DatasetError(f"the {called} is {foreign.info.get(key)!r}, version {version.id} has {info[key]!r}",
                               where=foreign.folder, mend="import it without --like: it becomes a version of its own")
    own = {n: v for n, v in features_in(of).items() if not n.startswith("skew.")}
    refuse_others(foreign.features, own, robot=str(info["robot_type"]), where=foreign.folder)


def _agreed(store: Store, id: str | None) -> Consent:
    """The record of whoever drove the robot; a foreign dataset is always somebody's."""
    record = store.consent(id) if id is not None else None
    flaw = consents_now(store).ends(record) if record is not None else None
    if record is None or flaw is not None:
        raise ConsentError("an imported dataset needs the consent of whoever drove the robot",
                           where=f"consent {NO_CONSENT!r}" if flaw is None else flaw.reason,
                           mend="hardcase consent add, then import with --consent ID")
    return record


def _checked(folder: Path) -> list[str]:
    """Warnings of the checks, one line each.

    Raises:
        HardcaseError: it cannot be read, or failed.
    """
    (checked,) = check([Item(folder, folder.resolve().name)], Contract())
    if checked.error is not None:
        raise checked.error
    assert checked.verdict is not None, "no error, so a verdict"
    if not checked.verdict.passed:
        raise DatasetError(f"the dataset failed its check: {checked.verdict.reason}", where=folder,
                           mend=f"see all that was found and its mends: hardcase check {folder}")
    return [finding.line() for finding in checked.verdict.findings]


def _imported(store: Store, foreign: Foreign, order: ImportOrder, consent: Consent,
              warnings: list[str]) -> dict[str, Any]:
    name = slug(order.name or order.folder.resolve().name)
    footage, packets = _footage(foreign)
    ids = identified(foreign, {place: one.digest for place, one in footage.items()})
    if gone := store.erased(ids):
        raise StoreError(f"episode {next(iter(gone))} was forgotten and does not come back", where=foreign.folder,
                         mend="take it out of the folder: lerobot-edit-dataset, delete_episodes")
    there = {str(id) for (id,) in store.query("SELECT id FROM episode WHERE id IN (SELECT value FROM json_each(?))",
                                              (json.dumps(ids),))}
    old = {e.id: e for e in store.episodes([id for id in ids if id in there])}
    if other := next((e for e in old.values() if e.consent != consent.id), None):
        raise StoreError(f"episode {other.id} is in the store with consent {other.consent!r}", where=foreign.folder,
                         mend=f"what is stored never changes: import with --consent {other.consent}")
    episodes = imported(foreign, ids, consent, known=old, keep=store.put_blobs)
    copied = _copied(store, footage, packets)
    place = {id: k for k, id in enumerate(ids)}
    recipe = Recipe(name=name, robot=episodes[0].scene.robot, dataset=DatasetConfig(
        sources=("imported",), only_success=False, weights={"base": 1.0},
        cameras={camera: CameraConfig() for camera in foreign.cameras.values()}))
    version = build(
        episodes, lambda e: FeatureTable(foreign.features, foreign.frames(place[e.id])), recipe, store=store.root,
        task={id: foreign.task(k) for k, id in enumerate(ids)}, generation=0, consents=consents_now(store),
        features=foreign.features, footage=lambda e, camera: footage[place[e.id], camera],
        notes={"imported": {"name": name, "share_when_added": order.weight}})
    store.add_version(version, [e for e in episodes if e.id not in old])
    return _told(version, len(ids) - len(old), copied, len(footage) - copied, warnings)


def _footage(foreign: Foreign) -> tuple[dict[tuple[int, str], ForeignFootage], dict[tuple[int, str], list[Any]]]:
    """(Episode, camera) -> its pictures, and the packets of the file that they are in."""
    found: dict[tuple[int, str], ForeignFootage] = {}
    packets: dict[tuple[int, str], list[Any]] = {}
    read: dict[Path, list[Any]] = {}
    for feature, camera in foreign.cameras.items():
        for k in range(len(foreign)):
            span = foreign.span(k, feature)
            if span.file not in read:
                read[span.file] = packets_of(span.file)
            packets[k, camera] = read[span.file]
            found[k, camera] = footage_of(span, int(foreign.episodes["length"][k]), foreign.fps, read[span.file])
    return found, packets


def _copied(store: Store, footage: Mapping[tuple[int, str], ForeignFootage],
            packets: Mapping[tuple[int, str], list[Any]]) -> int:
    """Cut videos that need no encoding out of the foreign ones; how many."""
    clips = Clips(store.root)
    return sum(keep_copy(clips, one, packets[key], store.tmp / f"import-{one.digest[:16]}.mp4")
               for key, one in footage.items())


def _told(version: DatasetVersion, new: int, copied: int, encoded: int, warnings: Sequence[str]) -> dict[str, Any]:
    return {"version": version.id, "recipe": version.recipe, "episodes": len(version.episodes),
            "frames": version.frames, "new": new, "copied": copied, "encoded": encoded, "warnings": list(warnings)}


def render(told: Mapping[str, Any]) -> str:
    """What was imported, in a few lines."""
    videos = f"; {told['copied']} videos copied, {told['encoded']} encoded or there" if (
        told["copied"] + told["encoded"]) else ""
    lines = [f"version {told['version']} ({told['recipe']}): {told['episodes']} episodes, {told['frames']} frames; "
             f"{told['new']} episodes are new{videos}"]
    return "\n".join([*lines, *(f"  warning: {w}" for w in told["warnings"])])
