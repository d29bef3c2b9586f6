"""Looks: what they change in a picture, and that they change nothing else."""

import numpy as np
import pytest

from pipeline.errors import ConfigError, PolicyError
from pipeline.protocols import Observation
from pipeline.simulation.appearance import LOOKS, NOMINAL, look_draws, look_from, randomize_look
from pipeline.simulation.eyes import Eyes, texture, with_eyes
from pipeline.simulation.physics import from_draws, randomize
from pipeline.simulation.rendering import CLOSE_UP, FilmCamera
from pipeline.twin.look import LAW, twin_look
from pipeline.twin.twin import draw_twin
from schemas.scene import Draw

SIZE = 64
STRONG = {name: trait.draw(np.random.default_rng(3), 1.0) for name, trait in LOOKS.items()} | {"look_texture": 0.4}


@pytest.fixture(scope="module")
def eyes(setup):
    with Eyes(setup.xml, ("close",), width=SIZE, height=SIZE) as opened:
        yield opened


@pytest.fixture(scope="module")
def states(make_world, starts):
    world = make_world(starts(2))
    return world.batch.state[np.arange(2)].copy()


def seen(eyes, states, *looks):
    return eyes.see(states[:len(looks)], np.full(len(looks), 0.02), looks)["close"].astype(int)


def test_a_scene_that_nothing_was_drawn_for_looks_as_every_film_shows_it(eyes, setup, states):
    with FilmCamera(setup.model, camera=CLOSE_UP, width=SIZE, height=SIZE) as film:
        assert (film.frames(states) == seen(eyes, states, NOMINAL, look_from(()))).all()


@pytest.mark.parametrize("trait", sorted(LOOKS.keys() - {"look_grain", "look_pattern"}))
def test_every_trait_changes_the_picture(eyes, states, trait):
    assert np.abs(seen(eyes, states, {**NOMINAL, trait: STRONG[trait]}) - seen(eyes, states, NOMINAL)).max() > 4


@pytest.mark.parametrize(("trait", "value"), [("look_grain", 1.0), ("look_pattern", 7.0)])
def test_a_texture_has_a_grain_and_a_pattern_of_its_own(eyes, states, trait, value):
    rough = {**NOMINAL, "look_texture": 0.4, "look_grain": 0.2}
    assert np.abs(seen(eyes, states, {**rough, trait: value}) - seen(eyes, states, rough)).max() > 4


def test_a_picture_does_not_depend_on_what_was_looked_at_before(eyes, states):
    one, other = (look_from(randomize_look(np.random.default_rng(k))) for k in (1, 2))
    both = np.stack([states[0]] * 2)
    assert (seen(eyes, both, one, other) == seen(eyes, both, other, one)[::-1]).all()
    assert (seen(eyes, states, NOMINAL, NOMINAL)[1] == seen(eyes, states[1:], NOMINAL)[0]).all()


def test_a_camera_moved_to_its_right_sees_the_cube_further_left(eyes, states):
    def column(look):
        picture = seen(eyes, states, look)[0]
        others = picture[..., 1:].max(axis=-1)
        return np.nonzero((picture[..., 0] > 90) & (others < 0.5 * picture[..., 0]))[1].mean()

    straight = column(NOMINAL)
    assert column({**NOMINAL, "look_camera_x": 0.05}) < straight - 2
    assert column({**NOMINAL, "look_camera_pan": 0.1}) > straight + 2, "turned left, what it sees moves right"


def test_a_look_is_no_physics_and_physics_no_look():
    rng = np.random.default_rng(0)
    physics, look = randomize(rng), randomize_look(rng)
    drawn = from_draws([(*physics, *look)])
    assert all((getattr(drawn, d.name) == d.value).all() for d in physics)
    assert look_draws((*physics, *look)) == look
    assert look_from((*physics, *look)) == {d.name: d.value for d in look}
    assert look_from(physics) == NOMINAL


def test_a_texture_has_no_seam_and_no_contrast_unless_asked_for():
    waves = texture(0.5, 0.3, 11.0).astype(int)
    inside = np.abs(np.diff(waves, axis=0)).max()
    assert np.abs(waves[0] - waves[-1]).max() <= inside + 1, "the last row goes on in the first"
    assert (texture(0.0, 1.0, 11.0) == 255).all()
    assert waves.min() >= 127, "half the brightness at most is taken away"


def test_an_unknown_camera_lists_those_there_are(setup):
    with pytest.raises(ConfigError, match="unknown camera 'side'") as caught:
        Eyes(setup.xml, ("side",), width=SIZE, height=SIZE)
    assert caught.value.mend == "use one of: close, front, top"


class Watching:
    """A policy that asks for pictures and keeps what it was shown."""

    def __init__(self, size: tuple[int, int] = (SIZE, SIZE)) -> None:
        self.cameras, self.shown = {"close": size}, []

    def reset(self, n: int) -> None:
        self.shown.clear()

    def act(self, observation: Observation, ids) -> np.ndarray:
        self.shown.append(observation.pictures.get("close"))
        return np.tile([0, 0, 0, 0, 0.08], (len(ids), 1))

    def memory(self, ids) -> np.ndarray:
        return np.full((len(ids), 1), 5.0)


def test_a_policy_that_asks_is_shown_its_own_attempts_under_their_looks(eyes, make_world, starts):
    world, policy, looks = make_world(starts(3)), Watching(), [NOMINAL, {**NOMINAL, "look_light": 0.5}, NOMINAL]
    ids = np.array([2, 1])
    with with_eyes(policy, world, looks) as driver:
        driver.act(world.observe(ids), ids)
        assert (driver.memory(ids) == 5.0).all(), "its memory is still the one that is recorded"
    expected = eyes.see(world.batch.state[ids], np.full(2, 0.02), [looks[2], looks[1]])["close"]
    assert (policy.shown[0] == expected).all()


def test_nothing_is_rendered_for_a_policy_that_does_not_ask(make_world, starts, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "none")
    blind = Watching()
    del blind.cameras
    world = make_world(starts(1))
    with with_eyes(blind, world, [NOMINAL]) as driver:
        assert driver is blind


def test_policies_that_want_different_pictures_cannot_ride_together(make_world, starts):
    with pytest.raises(PolicyError, match="want pictures of sizes") as caught, \
            with_eyes(Watching(), make_world(starts(1)), [NOMINAL], Watching((32, 32))):
        pass
    assert "deploy.shadow: false" in caught.value.mend


def test_every_twin_has_a_look_of_its_own_and_the_physics_it_always_had():
    assert LAW.keys() == LOOKS.keys(), "each trait has a law"
    looks = [twin_look(seed) for seed in (100, 101, 100)]
    assert looks[0] == looks[2] and looks[0] != looks[1]
    assert all(look[name] != NOMINAL[name] for look in looks for name in LOOKS)
    assert all(look["look_pattern"] >= 1 << 16 for look in looks), "no texture that training draws"
    assert draw_twin(100).draws[0] == Draw(name="kp", unit="1", value=0.7859188717962295)
