"""Clean material for the self-test, made by the stages of the loop: the same seed gives the same episodes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.consent import NO_CONSENTS
from pipeline.errors import SimulationError
from pipeline.files import sha256_file, short_id
from pipeline.recording import read_attachments, read_episode, read_frames
from pipeline.selftest.cameras import TOPICS, decoded, jpeg_of
from pipeline.selftest.filming import CAMERAS, HEIGHT, WIDTH, drawn, film
from pipeline.selftest.hands import Hesitant
from pipeline.selftest.log import Log
from pipeline.selftest.material import Kind, Material
from pipeline.selftest.values import coarse
from pipeline.selftest.video import add_videos
from pipeline.simulation.recordings import Recorded
from pipeline.simulation.refilm import SceneFilm
from pipeline.simulation.tasks import load_task
from pipeline.trace import Trace
from schemas.contract import Contract
from schemas.episode import Episode
from schemas.recipe import CollectConfig, DatasetConfig, DeployConfig, HarvestConfig, Recipe
from stages.build import build
from stages.check import Item, init
from stages.collect import collect
from stages.deploy import deploy
from stages.harvest import harvest

CLEAN_EPISODES = 100
FILMS, CORRECTIONS, DEPLOYED, COARSE = 12, 12, 40, 8
"""Recorded with cameras; corrected at most; deployed, and of these read through coarse encoders. Plain
demonstrations fill up to CLEAN_EPISODES."""
FILMED_EPISODES = 6
"""Episodes of the dataset with cameras."""
TWIN = 100
"""The first seed of the twins that the attempts are made on."""
RECIPE = Recipe(
    name="selftest", threads=1, collect=CollectConfig(demonstrations=CLEAN_EPISODES - DEPLOYED),
    deploy=DeployConfig(episodes=DEPLOYED, rare_share=0.25),
    harvest=HarvestConfig(corrections=CORRECTIONS, operator_delay_ticks=12),
    dataset=DatasetConfig(sources=("scripted", "corrected"), weights={"base": 0.7, "corrections": 0.3}, held_out=0.3))
SOFTWARE = {"software_commit": "selftest"}


def make_material(folder: Path, seed: int) -> Material:
    """Record 100 clean episodes and build datasets from some of them.

    Args:
        folder: an empty folder.
        seed: decides starts, misses, pauses and the clock of the live recordings.
    """
    demos = collect(RECIPE, seed=seed, folder=folder / "demonstrated", software=SOFTWARE)
    attempts = deploy(Hesitant(seed), short_id("hesitant", seed), RECIPE, seed=seed, twin=TWIN + seed, generation=0,
                      folder=folder / "deployed", software=SOFTWARE).recorded
    corrections = harvest([read_episode(r.path) for r in attempts], RECIPE, twin=TWIN + seed, generation=0,
                          folder=folder / "corrected", software=SOFTWARE).recorded
    films, rendered = _films(demos[:FILMS], folder / "filmed", seed)
    grained = _coarse(attempts[:COARSE], folder / "coarse")
    plain = demos[FILMS:CLEAN_EPISODES - DEPLOYED - len(corrections)]
    fine = [(r.path, r.episode.outcome.label) for r in attempts[COARSE:]]
    clean: dict[Kind, tuple[Path, ...]] = {
        "demonstrated": tuple(r.path for r in plain),
        "succeeded": tuple(path for path, label in fine if label == "success"),
        "failed": tuple(path for path, label in fine if label == "failure"),
        "coarse": grained,
        "corrected": tuple(r.path for r in corrections),
        "filmed": tuple(films),
        "dataset": _versions(plain, corrections, folder / "store"),
        "film dataset": (_film_dataset(films[:FILMED_EPISODES], folder),),
    }
    contract = _contract([path for kind in ("demonstrated", "succeeded", "failed") for path in clean[kind][:2]])
    contracts: dict[Kind, Contract] = dict.fromkeys(clean, contract)
    contracts |= {"filmed": _contract(films[:2]), "dataset": _contract(clean["dataset"]), "film dataset": Contract()}
    return Material(clean, contracts, rendered)


def _contract(good: Sequence[Path]) -> Contract:
    """What `hardcase check --init` writes of good recordings."""
    return init([Item(path, path.name) for path in good], name="selftest")


def _coarse(attempts: Sequence[Recorded], folder: Path) -> tuple[Path, ...]:
    """Attempts as a robot with coarse encoders would have recorded them."""
    folder.mkdir()
    for attempt in attempts:
        log = Log.read(attempt.path)
        coarse(log)
        log.write(folder / attempt.path.name)
    return tuple(folder / attempt.path.name for attempt in attempts)


def _films(demos: Sequence[Recorded], folder: Path, seed: int) -> tuple[list[Path], bool]:
    """Demonstrations recorded live with two cameras, and whether their pictures were rendered."""
    folder.mkdir()
    paths: list[Path] = []
    rendered = True
    for k, demo in enumerate(demos):
        episode, trace = read_episode(demo.path)
        attachments = read_attachments(demo.path)
        try:
            pictures = _rendered(episode, trace, attachments["scene.xml"]) if rendered else None
        except SimulationError:
            rendered, pictures = False, None
        paths.append(folder / demo.path.name)
        film(paths[-1], episode, trace, pictures or drawn(trace, attachments["scene.xml"]), attachments,
             np.random.default_rng([0xF11A, seed, k]))
    return paths, rendered


def _rendered(episode: Episode, trace: Trace, scene: bytes) -> dict[str, NDArray[np.uint8]]:
    with SceneFilm(scene, episode.scene.object_half_m, CAMERAS, width=WIDTH, height=HEIGHT) as shown:
        pictures = [shown.render(state) for state in trace.sim_state]
    return {name: np.stack([p[name] for p in pictures]) for name in CAMERAS}


def _film_dataset(films: Sequence[Path], folder: Path) -> Path:
    """A dataset with the videos of two cameras, from recordings with cameras."""
    pictures: list[dict[str, NDArray[np.uint8]]] = []
    for path in films:
        log = Log.read(path)
        pictures.append({camera: np.stack([decoded(jpeg_of(m)) for m in log.of(topic)])
                         for camera, topic in zip(CAMERAS, TOPICS, strict=True)})
    read = [read_frames(path) for path in films]
    episodes = [e.model_copy(update={"blob": sha256_file(path)}) for (e, _), path in zip(read, films, strict=True)]
    version = build(episodes, {e.id: f for e, f in read}, RECIPE, store=folder / "films",
                    task=load_task(RECIPE.task).instruction, generation=0, consents=NO_CONSENTS)
    add_videos(folder / "films" / version.path, folder / "film dataset", pictures)
    return folder / "film dataset"


def _versions(demos: Sequence[Recorded], corrections: Sequence[Recorded], store: Path) -> tuple[Path, ...]:
    """A version of demonstrations, and its child with corrections."""
    read = [read_frames(r.path) for r in (*demos[:12], *corrections)]
    frames = {e.id: f for e, f in read}
    episodes = [r.episode for r in (*demos[:12], *corrections)]
    task = load_task(RECIPE.task).instruction
    first = build(episodes[:12], frames, RECIPE, store=store, task=task, generation=0, consents=NO_CONSENTS)
    second = build(episodes, frames, RECIPE, store=store, task=task, generation=1, parent=first, consents=NO_CONSENTS)
    return store / first.path, store / second.path
