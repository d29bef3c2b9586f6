import numpy as np
import pytest

from pipeline.recording import read_attachments, read_episode
from pipeline.simulation.bodies import load_body
from pipeline.simulation.model import compose
from pipeline.simulation.physics import from_draws
from pipeline.simulation.world import CONTROLLER_WIDTH, World
from stages.collect import collect

pytestmark = pytest.mark.xdist_group("stages")


def test_the_same_seed_gives_the_same_file_bytes(recipe, seed, demonstrations, software, bytes_of, tmp_path):
    again = collect(recipe, seed=seed, folder=tmp_path, software=software)
    assert [r.episode for r in again] == [r.episode for r in demonstrations]
    assert bytes_of(tmp_path) == bytes_of(demonstrations[0].path.parent)


def test_another_seed_gives_other_starts(recipe, seed, demonstrations, software, tmp_path):
    few = recipe.model_copy(update={"collect": recipe.collect.model_copy(update={"demonstrations": 2})})
    other = collect(few, seed=seed + 1, folder=tmp_path, software=software)
    starts = {r.episode.scene.object_xy_m for r in demonstrations}
    assert not starts & {r.episode.scene.object_xy_m for r in other}


def test_a_demonstration_starts_common_and_is_labelled_by_the_simulator(demonstrations, recipe):
    assert len(demonstrations) == recipe.collect.demonstrations
    for recorded in demonstrations:
        episode = recorded.episode
        assert (episode.origin, episode.scene.stratum, episode.scene.family) == ("scripted", "common", "demo")
        assert episode.outcome.judged_by == "simulator"
        assert [s.kind for s in episode.segments] == ["demonstration"]
    assert sum(r.episode.outcome.label == "success" for r in demonstrations) >= 0.8 * len(demonstrations)


def test_an_attempt_cut_short_is_kept_as_a_failure(recipe, seed, software, tmp_path):
    short = recipe.model_copy(update={"collect": recipe.collect.model_copy(
        update={"demonstrations": 2, "max_ticks": 20})})
    made = collect(short, seed=seed, folder=tmp_path, software=software)
    assert [(r.episode.outcome.label, r.episode.frames) for r in made] == [("failure", 20)] * 2
    assert all(r.path.exists() for r in made)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99], ids=["first frame", "reaching", "carrying", "last frame"])
def test_a_recorded_attempt_is_restored_at_any_frame_and_replays_to_the_bit(demonstrations, same_bits, share):
    episode, trace = read_episode(demonstrations[0].path)
    world = World(compose(load_body("arm"), "table"), [episode.scene], from_draws([episode.scene.draws]), threads=1)
    ids, k = np.arange(1), int(share * len(trace))
    world.load(ids, trace.sim_state[[k]], trace.controller[[k], :CONTROLLER_WIDTH])
    for tick in range(k, len(trace)):
        seen = world.observe(ids)
        assert same_bits(seen.state[0], trace.state[tick])
        assert same_bits(seen.environment[0], trace.environment[tick])
        assert same_bits(world.save(ids)[0][0], trace.sim_state[tick])
        world.act(trace.action[[tick]], ids)
        assert same_bits(world.sent(ids)[0], trace.joint_action[tick])
    assert bool(world.succeeded(ids)[0]) is (episode.outcome.label == "success")


def test_a_recording_carries_its_model_and_the_experts_settings(demonstrations):
    attached = read_attachments(demonstrations[0].path)
    assert b"<mujoco" in attached["scene.xml"]
    assert b"<robot" in attached["robot.urdf"]
    assert b'"gate"' in attached["config.json"]
    assert attached["randomization.json"] == b"[]"
