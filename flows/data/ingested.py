"""A dataset version of ingested episodes: who may be learnt from, and what waits."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from flows.data.consents import consents_now
from flows.data.ingesting import Taken
from pipeline.check.door import Verdicts
from pipeline.errors import ConfigError, DatasetError
from pipeline.footage import decode, fitted
from pipeline.frames import FeatureTable
from pipeline.logs.cameras import Images
from pipeline.logs.convert import CAMERA, FRAMES
from pipeline.logs.footage import IngestedFootage
from pipeline.logs.tables import FrameFile
from pipeline.store import Store
from schemas.conversion import Conversion, Converted
from schemas.dataset import DatasetVersion
from schemas.episode import Episode
from schemas.ingest import IngestMap
from schemas.recipe import CameraConfig, DatasetConfig, Recipe
from stages.build import build


@dataclass(frozen=True, slots=True)
class Built:
    """A version that was built from ingested episodes, and what did not reach it."""

    version: DatasetVersion
    left_out: Mapping[str, int]
    """Reason -> episodes that stay in the store and out of the version."""
    cameras: Mapping[str, CameraConfig]
    """Cameras whose images it holds as videos."""
    waiting: Mapping[str, str]
    """Camera whose images wait in the store, and why: the version has no video of them."""


def build_version(store: Store, name: str, declared: IngestMap, taken: Sequence[Taken],
                  sizes: Mapping[str, CameraConfig] | None = None) -> Built:
    """A dataset version of all episodes that may be learnt from, with the features, skews and cameras of the map.

    An episode whose person does not consent, that failed, or whose log or frames failed a check stays out. A camera
    whose images are no JPEG or PNG waits, and is told.

    Args:
        store: holds what the logs became.
        name: of the version's recipe.
        declared: the map.
        taken: what became of each log.
        sizes: camera -> size of its videos; the camera's own where it is not named.

    Raises:
        ConsentError: no episode has a consent that holds; names the first.
        ConfigError: no episode is left, or a size is given for a camera that the map does not have.
        DatasetError: the features of two logs differ, or an image that a frame uses is damaged.
    """
    wanted = sizes or {}
    if odd := [camera for camera in wanted if camera not in declared.cameras]:
        raise ConfigError(f"the map has no camera {odd[0]!r}", where="--camera",
                          mend=f"use one of: {', '.join(declared.cameras) or 'none is declared'}")
    converted = {e.id: t for t in taken for e in t.episodes}
    episodes = list({e.id: e for t in taken for e in t.episodes}.values())
    if not episodes:
        raise ConfigError("no log gave an episode", where=f"--dataset {name}",
                          mend="see the problems of each log above, mend the map, and ingest again")
    consents = consents_now(store)
    agreed = [e for e in episodes if consents.flaw(e) is None]
    if not agreed:
        consents.check(episodes)
    sound = [e for e in agreed if e.outcome.label != "failure"]
    verdicts = _verdicts(store, sound, converted)
    good = verdicts.passing(sound)
    counts = (len(episodes) - len(agreed), len(agreed) - len(sound), len(sound) - len(good))
    left_out = {why: n for why, n in zip(("no consent that holds", "failure", "failed a check"), counts, strict=True)
                if n}
    if not good:
        told = ", ".join(f"{n} {why}" for why, n in left_out.items())
        raise ConfigError(f"none of {len(episodes)} episodes may be learnt from ({told})", where=f"--dataset {name}",
                          mend="see what the checks found: hardcase check LOG; or ingest attempts that succeeded")
    made = {t.conversion.id: t.conversion for t in (converted[e.id] for e in good)}
    waiting = _waiting(store, made)
    cameras = {n: wanted.get(n, CameraConfig()) for n in sorted(declared.cameras) if n not in waiting}
    version = _build(store, name, declared, good, converted, verdicts, _notes(made, waiting), cameras)
    return Built(version, left_out, cameras, waiting)


def _waiting(store: Store, made: Mapping[str, Conversion]) -> dict[str, str]:
    """Cameras that no video can be made of, with the reason: their first image says it."""
    found: dict[str, str] = {}
    for conversion in made.values():
        for camera in sorted(_result(conversion).cameras):
            try:
                fitted(decode(Images(store.blob(conversion.files[CAMERA + camera]))[0], camera), CameraConfig(), camera)
            except DatasetError as error:
                found[camera] = error.what
    return found


def _build(store: Store, name: str, declared: IngestMap, episodes: list[Episode], converted: Mapping[str, Taken],
           verdicts: Verdicts, notes: Mapping[str, object],
           cameras: Mapping[str, CameraConfig]) -> DatasetVersion:
    files: dict[str, FrameFile] = {}

    def place(episode: Episode) -> tuple[Conversion, FrameFile, int]:
        taken = converted[episode.id]
        sha = taken.conversion.files[FRAMES]
        if sha not in files:
            files[sha] = FrameFile(store.blob(sha), _result(taken.conversion))
        return taken.conversion, files[sha], [e.id for e in taken.episodes].index(episode.id)

    def frames_of(episode: Episode) -> FeatureTable:
        _, file, number = place(episode)
        return file.table(number)

    def footage(episode: Episode, camera: str) -> IngestedFootage:
        made, file, number = place(episode)
        images = made.files[CAMERA + camera]
        return IngestedFootage(file, number, camera, store.blob(images), blob=images)

    recipe = Recipe(name=name, robot=declared.robot,
                    dataset=DatasetConfig(sources=("ingested",), only_success=False, weights={"base": 1.0},
                                          cameras=dict(cameras)))
    version = build(episodes, frames_of, recipe, store=store.root, task=declared.task, generation=0,
                    consents=consents_now(store), verdicts=verdicts,
                    features=_result(converted[episodes[0].id].conversion).features, footage=footage, notes=notes)
    store.add_version(version)
    return version


def _verdicts(store: Store, episodes: Sequence[Episode], converted: Mapping[str, Taken]) -> Verdicts:
    """What the checks found of the logs, which counts for everything that was made of them."""
    log_of = {e.blob or "": converted[e.id].conversion.log for e in episodes}
    found = store.checks({*log_of, *log_of.values()})
    return Verdicts({blob: verdict for blob, log in log_of.items()
                     if (verdict := found.get(blob) or found.get(log)) is not None})


def _result(made: Conversion) -> Converted:
    assert made.result is not None, "only what was converted has episodes"
    return made.result


def _notes(made: Mapping[str, Conversion], cameras: Iterable[str]) -> dict[str, object]:
    """What the manifest says: the conversions, and where the images of each camera wait; `frames` says which image
    each frame uses."""
    waiting = {camera: [{"images": c.files[CAMERA + camera], "frames": c.files[FRAMES]} for c in made.values()
                        if CAMERA + camera in c.files] for camera in cameras}
    return {"ingested": {"conversions": list(made), "cameras_waiting": waiting}}
