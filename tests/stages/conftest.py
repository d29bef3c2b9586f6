"""A small loop's pieces, each made once: demonstrations, variants, two policies, deployed attempts."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.deployed import Deployed
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.recording import read_episode, read_frames
from pipeline.shadow.riders import Riders
from schemas.recipe import (
    AugmentConfig,
    CollectConfig,
    DeployConfig,
    ExamConfig,
    HarvestConfig,
    Recipe,
    TrainConfig,
)
from stages.augment import Augmented, augment
from stages.build import build
from stages.collect import collect
from stages.deploy import deploy
from stages.harvest import Attempt, Harvested, harvest
from stages.train import train

SEED, TWIN = 3, 4
SOFTWARE = {"software_commit": "tests"}


@pytest.fixture(scope="session")
def recipe() -> Recipe:
    """A few seconds of a loop."""
    return Recipe(
        name="tests", collect=CollectConfig(demonstrations=10), augment=AugmentConfig(),
        train=TrainConfig(steps=300, batch=128, checkpoint_every=300),
        deploy=DeployConfig(episodes=16, rare_share=0.25),
        harvest=HarvestConfig(corrections=6), exam=ExamConfig(common=8, rare=4))


@pytest.fixture(scope="session")
def seed() -> int:
    return SEED


@pytest.fixture(scope="session")
def twin() -> int:
    """One of the twins that everything is tuned on."""
    return TWIN


@pytest.fixture(scope="session")
def software() -> dict[str, str]:
    return SOFTWARE


@pytest.fixture(scope="session")
def demonstrations(recipe, tmp_path_factory):
    """Recorded demonstrations, in files."""
    return collect(recipe, seed=SEED, folder=tmp_path_factory.mktemp("demonstrations"), software=SOFTWARE)


@pytest.fixture(scope="session")
def parents(demonstrations):
    """(episode, frames) of each demonstration."""
    return [read_frames(r.path) for r in demonstrations]


@pytest.fixture(scope="session")
def variants_of(parents) -> Callable[..., Augmented]:
    """Makes variants of the demonstrations as the loop does at generation 0."""

    def make(replays: int = 10, retargets: int = 14, seed: int = SEED, **config: float) -> Augmented:
        return augment(parents, AugmentConfig(**config), replays=replays, retargets=retargets, seed=seed, generation=0,
                       strata=("common",), threads=2)

    return make


@pytest.fixture(scope="session")
def variants(variants_of) -> Augmented:
    return variants_of()


@pytest.fixture(scope="session")
def learnt(recipe, demonstrations, parents, variants, tmp_path_factory) -> SimpleNamespace:
    """Two policies from one dataset version: champion and a policy of another training seed."""
    store = tmp_path_factory.mktemp("learnt")
    kept = [e.model_copy(update={"blob": "0" * 64}) for e in variants.episodes if e.outcome.label == "success"]
    frames = {r.episode.id: f for r, (_, f) in zip(demonstrations, parents, strict=True)} | variants.frames
    version = build([*(r.episode for r in demonstrations), *kept], frames, recipe, store=store, task="pick",
                    generation=0)
    data = TrainingData.load(store / version.path)
    champion, other = (train(version, data, recipe.train, seed=s, store=store) for s in (0, 1))
    return SimpleNamespace(store=store, champion=champion, other=other)


@pytest.fixture(scope="session")
def policy(learnt) -> Callable[..., OnnxPolicy]:
    """Opens one of the two policies anew."""

    def opened(record) -> OnnxPolicy:
        return OnnxPolicy(learnt.store / record.checkpoint / "policy.onnx")

    return opened


@pytest.fixture(scope="session")
def deploy_with(recipe, learnt, policy, tmp_path_factory) -> Callable[..., Deployed]:
    """Lets the champion work, with a policy in its shadow or without one."""

    def work(rider=None) -> Deployed:
        files = {} if rider is None else {rider.id: learnt.store / rider.checkpoint / "policy.onnx"}
        with Riders(files, patient=True) as riders:
            return deploy(policy(learnt.champion), learnt.champion.id, recipe, seed=SEED, twin=TWIN, generation=0,
                          folder=tmp_path_factory.mktemp("deployed"), software=SOFTWARE, riders=riders)

    return work


@pytest.fixture(scope="session")
def deployed(deploy_with, learnt) -> Deployed:
    """The champion at work, the other policy in its shadow."""
    return deploy_with(learnt.other)


@pytest.fixture(scope="session")
def attempts(deployed) -> list[Attempt]:
    """(episode, trace) of every deployed attempt, read back from its recording."""
    return [read_episode(r.path) for r in deployed.recorded]


@pytest.fixture(scope="session")
def harvest_with(attempts, recipe, tmp_path_factory) -> Callable[..., Harvested]:
    """Harvests the attempts with other habits of the operator."""

    def harvested(**config: object) -> Harvested:
        changed = recipe.model_copy(update={"harvest": recipe.harvest.model_copy(update=config)})
        return harvest(attempts, changed, twin=TWIN, generation=0, folder=tmp_path_factory.mktemp("harvested"),
                       software=SOFTWARE)

    return harvested


@pytest.fixture(scope="session")
def harvested(harvest_with) -> Harvested:
    return harvest_with()


@pytest.fixture(scope="session")
def corrections(harvested):
    """(episode, trace) of each correction, read back from its recording."""
    return [read_episode(r.path) for r in harvested.recorded]


@pytest.fixture(scope="session")
def same_bits() -> Callable[..., bool]:
    """Whether two arrays hold the same bits, NaN included."""

    def same(one, other) -> bool:
        one, other = np.asarray(one), np.asarray(other)
        return one.shape == other.shape and one.dtype == other.dtype and one.tobytes() == other.tobytes()

    return same


@pytest.fixture(scope="session")
def bytes_of() -> Callable[[Path], dict[str, bytes]]:
    """File name -> content of everything in a folder."""
    return lambda folder: {file.name: file.read_bytes() for file in sorted(folder.iterdir())}
