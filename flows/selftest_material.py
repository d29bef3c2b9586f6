"""Clean material for the self-test, made by the stages of the loop: the same seed gives the same episodes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.consent import NO_CONSENTS
from pipeline.errors import SimulationError
from pipeline.files import short_id
from pipeline.recording import read_attachments, read_episode, read_frames
from pipeline.selftest.filming import CAMERAS, HEIGHT, WIDTH, drawn, film
from pipeline.selftest.hands import Hesitant
from pipeline.selftest.material import Kind, Material
from pipeline.simulation.recordings import Recorded
from pipeline.simulation.refilming import refilm
from pipeline.simulation.tasks import load_task
from schemas.contract import Contract
from schemas.recipe import CollectConfig, DatasetConfig, DeployConfig, HarvestConfig, Recipe
from stages.build import build
from stages.check import Item, init
from stages.collect import collect
from stages.deploy import deploy
from stages.harvest import harvest

CLEAN_EPISODES = 100
FILMS, CORRECTIONS, DEPLOYED = 12, 12, 40
"""Recorded with cameras, corrected at most, deployed; plain demonstrations fill up to CLEAN_EPISODES."""
TWIN = 100
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
    plain = demos[FILMS:CLEAN_EPISODES - DEPLOYED - len(corrections)]
    failed = [r.episode.outcome.label == "failure" for r in attempts]
    clean: dict[Kind, tuple[Path, ...]] = {
        "demonstrated": tuple(r.path for r in plain),
        "succeeded": tuple(r.path for r, bad in zip(attempts, failed, strict=True) if not bad),
        "failed": tuple(r.path for r, bad in zip(attempts, failed, strict=True) if bad),
        "corrected": tuple(r.path for r in corrections),
        "filmed": tuple(films),
        "dataset": _versions(plain, corrections, folder / "store"),
    }
    contract = _contract([path for kind in ("demonstrated", "succeeded", "failed") for path in clean[kind][:2]])
    contracts: dict[Kind, Contract] = dict.fromkeys(clean, contract)
    contracts["filmed"], contracts["dataset"] = _contract(films[:2]), Contract()
    return Material(clean, contracts, rendered)


def _contract(good: Sequence[Path]) -> Contract:
    """What `hardcase check --init` writes of good recordings."""
    return init([Item(path, path.name) for path in good], name="selftest")


def _films(demos: Sequence[Recorded], folder: Path, seed: int) -> tuple[list[Path], bool]:
    """Demonstrations recorded live with two cameras, and whether their pictures were rendered."""
    folder.mkdir()
    paths: list[Path] = []
    rendered = True
    for k, demo in enumerate(demos):
        episode, trace = read_episode(demo.path)
        attachments = read_attachments(demo.path)
        scene = attachments["scene.xml"]
        try:
            pictures = refilm(scene, trace.sim_state, CAMERAS, width=WIDTH, height=HEIGHT) if rendered else {}
        except SimulationError:
            rendered, pictures = False, {}
        paths.append(folder / demo.path.name)
        film(paths[-1], episode, trace, pictures or drawn(trace, scene), attachments,
             np.random.default_rng([0xF11A, seed, k]))
    return paths, rendered


def _versions(demos: Sequence[Recorded], corrections: Sequence[Recorded], store: Path) -> tuple[Path, ...]:
    """A version of demonstrations, and its child with corrections."""
    read = [read_frames(r.path) for r in (*demos[:12], *corrections)]
    frames = {e.id: f for e, f in read}
    episodes = [r.episode for r in (*demos[:12], *corrections)]
    task = load_task(RECIPE.task).instruction
    first = build(episodes[:12], frames, RECIPE, store=store, task=task, generation=0, consents=NO_CONSENTS)
    second = build(episodes, frames, RECIPE, store=store, task=task, generation=1, parent=first, consents=NO_CONSENTS)
    return store / first.path, store / second.path
