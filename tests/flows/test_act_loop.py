"""A whole loop of a policy that sees, through the stages that any policy goes through."""

import hashlib

import numpy as np
import pytest

from flows.commands.by_hand import run_stage
from flows.data.forgetting import carried_out, planned
from flows.run.footage import filming
from flows.run.opening import order_of, recall
from flows.run.seeing import filmed
from flows.run.steps import open_run
from flows.studies.study import turn
from pipeline.errors import ConfigError, StoreError
from pipeline.lerobot_view.samples import Samples
from pipeline.policies.act_onnx import ActOnnx
from pipeline.recipes import load_recipe
from pipeline.recording.camera import RecordedFootage
from pipeline.simulation.appearance import LOOKS, look_draws
from pipeline.simulation.rendering import backend
from pipeline.store import Store
from stages.build import load_version

FEATURE = "observation.images.close"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """The store of a finished loop with one lap."""
    backend()  # where nothing renders, this says what to install
    root, recipe = tmp_path_factory.mktemp("act") / "store", load_recipe("act-smoke")
    with open_run(root, recipe.model_copy(update={"threads": 1}), seed=0, twin=0, control=False) as steps:
        turn(steps, recipe.generations)
    return root


@pytest.fixture
def steps(root):
    recipe = load_recipe("act-smoke").model_copy(update={"threads": 1})
    with open_run(root, recipe, seed=0, twin=0, control=False) as opened:
        yield opened


def test_every_stage_is_done_once_and_the_policy_sees(steps):
    assert all(step.resumed for step in (steps.train(1, quiet), steps.gate(1, quiet), steps.exam(1, quiet)))
    policy = steps.policy(steps.champion(0))
    assert isinstance(policy, ActOnnx) and policy.cameras == {"close": (32, 32)}
    assert steps.store.policy(steps.champion(0)).kind == "act"


def test_variants_are_seen_under_looks_of_their_own_and_demonstrations_as_they_were(steps):
    variants = steps.store.episodes(steps.material.ids(0, "augment"))
    assert all({d.name for d in look_draws(e.scene.draws)} == LOOKS.keys() for e in variants)
    assert len({look_draws(e.scene.draws) for e in variants}) == len(variants)
    assert not any(look_draws(e.scene.draws) for e in steps.store.episodes(steps.material.ids(0, "collect")))


def test_the_version_shows_every_frame_from_the_state_it_was_in(root, steps):
    version = steps.material.version(1)
    samples = Samples.load(root / version.path)
    place = {id: k for k, id in enumerate(version.episodes)}
    assert [len(film) for film in samples.films[FEATURE]] == list(samples.stops - samples.starts)
    chosen = [steps.store.episodes(steps.material.ids(g, stage))[0] for g, stage in ((0, "collect"), (0, "augment"))]
    with filming(steps.store, steps.recipe, steps.material.frames, chosen) as footage:
        for episode in chosen:
            made, film = np.stack(list(footage(episode, "close").pictures())), samples.films[FEATURE][place[episode.id]]
            assert made.shape == film.shape
            assert np.abs(made.astype(int) - film).mean() < 8, "the same pictures, but for the video's loss"


def test_pictures_name_the_recording_they_follow_from_the_renderer_and_the_look(steps):
    demo, variant = (steps.store.episodes(steps.material.ids(0, stage))[0] for stage in ("collect", "augment"))
    parent = steps.store.episodes([variant.parent])[0]
    with filming(steps.store, steps.recipe, steps.material.frames, [variant]) as footage:
        plain, drawn = footage(demo, "close").source, footage(variant, "close").source
    assert plain.startswith(f"{demo.blob} ") and plain.endswith("nominal")
    assert drawn.startswith(f"{parent.blob} {variant.blob} ")
    assert f"look_light={next(d.value for d in variant.scene.draws if d.name == 'look_light')!r}" in drawn


def test_without_looks_the_same_states_are_seen_as_they_were(tmp_path, steps):
    """The control of the study: physics, starts and frames of its variants are those of the loop with looks."""
    plain = steps.recipe.model_copy(update={
        "generations": 0, "augment": steps.recipe.augment.model_copy(update={"appearance": False})})
    with open_run(tmp_path / "store", plain, seed=0, twin=0, control=False) as other:
        other.collect(0, quiet)
        other.augment(0, quiet)
        bare = other.store.episodes(other.material.ids(0, "augment"))
        dressed = steps.store.episodes(steps.material.ids(0, "augment"))
        assert not any(look_draws(e.scene.draws) for e in bare)
        for one, two in zip(bare, dressed, strict=True):
            assert (other.material.frames(one).state == steps.material.frames(two).state).all()


def test_what_the_robot_saw_is_in_its_recordings_and_teaches_as_it_was_taken(root, steps):
    deployed = steps.store.episodes(steps.material.ids(0, "deploy"))
    corrected = steps.store.episodes(steps.material.ids(0, "harvest"))
    for episode in (*deployed, *corrected):
        taken = RecordedFootage(steps.store.blob(episode.blob), "close", episode.frames, blob=episode.blob,
                                max_skew_s=0.1)
        assert taken.repeated == 0 and next(iter(taken.pictures())).shape == (32, 32, 3)
    fixed = [e for e in corrected if e.outcome.label == "success"]
    assert {e.id for e in fixed} <= set(load_version(root / steps.material.version(1).path).episodes)


def test_recordings_stay_as_they_are_where_no_camera_is_rendered(steps):
    assert filmed([], load_recipe("smoke"), 0) == []
    with filming(steps.store, load_recipe("smoke"), steps.material.frames, []) as footage:
        assert footage is None


def test_the_same_run_elsewhere_makes_the_same_policy(tmp_path, steps):
    first = steps.recipe.model_copy(update={"generations": 0})
    with open_run(tmp_path / "store", first, seed=0, twin=0, control=False) as again:
        for stage in ("collect", "augment", "build", "train"):
            getattr(again, stage)(0, quiet)
        policy = again.material.ids(0, "train")[0]
        assert policy == steps.material.ids(0, "train")[0]
        assert again.store.policy(policy).files == steps.store.policy(policy).files


def test_a_forgotten_demonstration_leaves_none_of_its_pictures(root, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(root))
    with Store.open(root) as store:
        demo = store.episodes(origin="scripted")[0]
        notes = [p for p in (root / "videos").glob("*.json") if str(demo.blob).encode() in p.read_bytes()]
        shown = {hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*.mp4")}
    assert notes, "its own pictures, and those of variants that replay it"
    carried_out(planned(demo.id, "a test", with_log=False)[0], lambda step: None)
    left = [p for p in (root / "videos").glob("*.json") if str(demo.blob).encode() in p.read_bytes()]
    assert not left
    assert {hashlib.sha256(p.read_bytes()).hexdigest() for p in root.rglob("*.mp4")} < shown


def test_a_kind_of_policy_chooses_its_recipe_and_its_run(root, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(root))
    assert order_of(None, None, None, None, policy="act").recipe == load_recipe("act")
    assert recall(root, policy="act").recipe.name == "act-smoke"
    assert run_stage("train", policy="act")["resumed"]
    with pytest.raises(StoreError, match="no run was begun here that trains chunked") as caught:
        run_stage("train", policy="chunked")
    assert caught.value.mend == "begin one: hardcase loop"
    with pytest.raises(ConfigError, match="sees, recipe 'default' keeps no pictures") as caught:
        order_of("default", None, None, None, policy="act")
    assert caught.value.mend == "use a recipe with a camera: --recipe act"
    with pytest.raises(ConfigError, match="unknown policy 'see'"):
        order_of(None, None, None, None, policy="see")


def quiet(done: int, total: int) -> None:
    """Nobody watches."""
