"""World: restorable to the bit, honest about what is perceived, strict about success."""

import numpy as np
import pytest

from pipeline.simulation.expert import Expert
from pipeline.simulation.physics import STRIBECK_RAD_S, from_draws, randomize
from pipeline.simulation.rollout import rollout
from pipeline.simulation.tracing import Tracer
from pipeline.simulation.world import CONTROLLER_WIDTH, HOME, LIMITS, OPEN_M, REACH, World
from pipeline.twin.twin import draw_twin, twin_world

NOTHING = np.array([0, 0, 0, 0, OPEN_M])
ROUGH = next(t for t in map(draw_twin, range(100)) if t.flex and "stiction" in {d.name for d in t.draws})
"""A twin with a flexible forearm, stiction and a jittering delay."""


def push(world: World, action: np.ndarray, ticks: int) -> np.ndarray:
    """Send one action again and again; servo targets after each tick, shape (ticks, n, 7)."""
    sent = []
    for _ in range(ticks):
        world.act(np.tile(action, (world.n, 1)), np.arange(world.n))
        sent.append(world.batch.bind("ctrl").copy())
    return np.array(sent)


def randomized(scenes) -> list:
    return [randomize(np.random.default_rng(i)) for i in range(len(scenes))]


@pytest.fixture(params=["randomized", "twin"])
def build(request, setup, starts):
    """threads -> a world of six attempts that ends in different ways."""
    scenes = starts(4) + starts(2, "large")
    if request.param == "twin":
        return lambda threads: twin_world(ROUGH, scenes, threads=threads)
    return lambda threads: World(setup, scenes, from_draws(randomized(scenes)), threads=threads)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_attempt_restored_at_any_frame_repeats_the_recorded_bits(build, threads):
    recorded, expert = build(2), Expert()
    expert.reset(recorded.n)
    tracer = Tracer(recorded)
    rollout(recorded, expert, tracer=tracer)
    traces = tracer.traces()
    for frame in (0, 13, 40):
        world = build(threads)
        ids = np.array([i for i, t in enumerate(traces) if len(t) > frame])
        world.load(ids, np.array([traces[i].sim_state[frame] for i in ids]),
                   np.array([traces[i].controller[frame, :CONTROLLER_WIDTH] for i in ids]))
        for k in range(frame, max(map(len, traces))):
            ids = np.array([i for i in ids if len(traces[i]) > k])
            seen, (rows, controller) = world.observe(ids), world.save(ids)
            assert (rows == [traces[i].sim_state[k] for i in ids]).all()
            assert (controller == [traces[i].controller[k, :CONTROLLER_WIDTH] for i in ids]).all()
            assert (seen.state == [traces[i].state[k] for i in ids]).all()
            assert (seen.environment == [traces[i].environment[k] for i in ids]).all()
            world.act(np.array([traces[i].action[k] for i in ids]), ids)
    assert (world.succeeded(np.arange(world.n)) == recorded.succeeded(np.arange(world.n))).all()


def test_an_attempt_begun_in_a_used_place_is_a_new_worlds_to_the_bit(setup, starts):
    scenes, used = starts(3) + starts(1, "large"), starts(4, "beside", first=50)
    drawn = from_draws(randomized(scenes))
    fresh = World(setup, scenes, drawn, threads=1)
    world = World(setup, used, from_draws([randomize(np.random.default_rng(90 + i)) for i in range(4)]), threads=2)
    push(world, np.array([0.01, 0.01, -0.01, 0.05, 0.0]), 15)
    others = world.save(np.array([1]))
    ids = np.array([0, 2, 3])
    world.restart(ids, [scenes[i] for i in ids], drawn.take(ids))
    assert all((a == b).all() for a, b in zip(world.save(np.array([1])), others, strict=True))
    assert world.scenes == (scenes[0], used[1], scenes[2], scenes[3])
    for _ in range(20):
        action = np.tile([0.005, -0.01, -0.006, 0.02, 0.02], (3, 1))
        one, two = world.observe(ids), fresh.observe(ids)
        assert (one.state == two.state).all()
        assert (one.environment == two.environment).all()
        world.act(action, ids)
        fresh.act(action, ids)
        assert all((a == b).all() for a, b in zip(world.save(ids), fresh.save(ids), strict=True))


def test_the_perceived_object_is_off_by_exactly_bias_and_noise(make_world, starts, idle):
    scenes, ids = starts(5), np.arange(5)
    world = make_world(scenes, bias_x=0.012, bias_y=-0.02, noise=0.002)
    for tick in range(10):
        seen, true = world.observe(ids).environment, world.truth(ids)
        noise = np.array([np.random.default_rng([s.seed, 7]).standard_normal((tick + 1, 3))[tick] for s in scenes])
        assert np.allclose(seen[:, :3], true[:, :3] + [0.012, -0.02, 0] + 0.002 * noise, atol=1e-12)
        assert (seen[:, 3] == true[:, 3]).all()
        idle(world, 1)


def test_looking_twice_shows_the_same_and_changes_nothing(make_world, starts):
    world, ids = make_world(starts(3), noise=0.002), np.arange(3)
    before = world.save(ids)
    one, two = world.observe(ids), world.observe(ids)
    assert (one.environment == two.environment).all()
    assert all((a == b).all() for a, b in zip(before, world.save(ids), strict=True))


def test_a_bending_forearm_is_not_perceived(starts):
    world, ids = twin_world(ROUGH, starts(2), threads=1), np.arange(2)
    push(world, np.array([0.02, 0.02, -0.01, 0, OPEN_M]), 5)
    world.batch.bind("site_xpos")
    world.batch.forward(ids)
    site = world.setup.model.site("tool").id
    true = world.batch.bind("site_xpos")[:, site]
    assert (np.linalg.norm(true - world.observe(ids).state[:, 7:10], axis=1) > 1e-4).all()


def test_without_hidden_structure_the_perceived_tool_is_the_tool(make_world, starts):
    world, ids = make_world(starts(2)), np.arange(2)
    push(world, np.array([0.02, 0.02, -0.01, 0, OPEN_M]), 5)
    world.batch.bind("site_xpos")
    world.batch.forward(ids)
    true = world.batch.bind("site_xpos")[:, world.setup.model.site("tool").id]
    assert np.allclose(true, world.observe(ids).state[:, 7:10], atol=1e-12)


def test_success_needs_the_cube_on_the_mark_let_go_and_away_for_the_hold_time(make_world, starts):
    done = [s.model_copy(update={"object_xy_m": s.target_xy_m}) for s in starts(4)]
    world, ids = make_world(done), np.arange(4)
    action = np.tile(NOTHING, (4, 1))
    action[1, 4] = 0.03                                  # closes
    for tick in range(1, 8):
        world.act(action, ids)
        assert world.succeeded(ids)[[0, 2, 3]].tolist() == [tick >= world.task.hold_ticks] * 3
    assert not world.succeeded(ids)[1]
    away = make_world(starts(4))
    push(away, NOTHING, 8)
    assert not away.succeeded(ids).any()


def test_steps_and_poses_are_held_within_their_limits(make_world, starts):
    world, ids = make_world(starts(1)), np.arange(1)
    world.act(np.array([[1.0, -1.0, 1.0, 1.0, 1.0]]), ids)
    assert np.allclose(world.observe(ids).state[0, 11:15] - HOME, LIMITS * [1, -1, 1, 1])
    push(world, np.array([1.0, -1.0, 1.0, 1.0, 1.0]), 60)
    assert np.allclose(world.observe(ids).state[0, 11:16], [*REACH[0, 1:], REACH[1, 0], *REACH[2:, 1], OPEN_M])


def test_a_delay_sends_every_command_that_many_ticks_later(make_world, starts):
    action = np.array([0.01, 0.005, -0.01, 0.02, 0.0])
    prompt, late = (push(make_world(starts(1), delay=d), action, 12) for d in (0, 2))
    assert (late[2:] == prompt[:-2]).all()
    assert (late[:2] == late[0]).all()


def test_jitter_is_one_tick_more_as_often_as_it_says_and_the_same_every_time(make_world, starts):
    action = np.array([0.01, 0.005, -0.01, 0.02, 0.0])
    always, later = (push(make_world(starts(1), **p), action, 12) for p in ({"jitter": 1.0}, {"delay": 1}))
    assert (always == later).all()
    some, again = (push(make_world(starts(40), jitter=0.3), action, 20) for _ in range(2))
    assert (some == again).all()
    prompt = push(make_world(starts(40)), action, 20)
    assert 0.2 < (some != prompt).any(axis=2).mean() < 0.4


def test_backlash_keeps_the_joint_behind_and_swallows_a_small_reversal(make_world, starts):
    world, tight = make_world(starts(1), backlash=0.01), make_world(starts(1))
    forward, back = np.array([0.02, 0, 0, 0, OPEN_M]), np.array([-0.0005, 0, 0, 0, OPEN_M])
    lag = push(tight, forward, 5) - push(world, forward, 5)
    assert np.abs(lag[..., :6]).max() == pytest.approx(0.005)
    push(world, NOTHING, 20)
    push(tight, NOTHING, 20)
    before = world.batch.bind("ctrl").copy()
    assert (push(world, back, 1)[0][:, :6] == before[:, :6]).all()
    still = tight.batch.bind("ctrl").copy()
    assert np.abs(push(tight, back, 1)[0] - still).max() > 1e-4


def test_stiction_holds_at_rest_and_lets_go_in_motion(make_world, starts):
    world = make_world(starts(1), stiction=2.0)
    push(world, NOTHING, 1)
    friction, nominal = world.batch.expanded("dof_frictionloss"), world.setup.model.dof_frictionloss
    assert np.allclose(friction[0, :6], 3 * nominal[:6], rtol=1e-2)
    push(world, np.array([0, 0.02, 0, 0, OPEN_M]), 10)  # joint1 turns at about 1 rad/s, many times the Stribeck speed
    assert abs(world.speeds(np.arange(1))[0, 0]) > 5 * STRIBECK_RAD_S
    assert friction[0, 0] == pytest.approx(nominal[0], rel=1e-2)


def test_a_sticky_arm_follows_a_small_step_late(make_world, starts, idle):
    moved = {}
    for stiction in (0.0, 10.0):
        world = make_world(starts(1), stiction=stiction)
        idle(world, 10)
        rest = world.observe(np.arange(1)).state[0, 8]
        push(world, np.array([0, 0.001, 0, 0, OPEN_M]), 1)
        idle(world, 1)
        moved[stiction] = world.observe(np.arange(1)).state[0, 8] - rest
    assert moved[10.0] < 0.5 * moved[0.0]


def test_rewards_are_the_tasks_terms_and_rise_towards_the_goal(make_world, demonstrations):
    scenes, traces = demonstrations
    world = make_world(scenes)
    assert len(world.task.weights) <= 5
    for trace in traces:
        assert set(trace.reward) == set(world.task.weights)
        assert trace.reward["success"][-1] == world.task.weights["success"]
        assert not trace.reward["success"][:-1].any()
        assert trace.reward["carry"][-1] > trace.reward["carry"][0]
        assert trace.reward["grasp"].max() == world.task.weights["grasp"]
        assert (trace.reward["effort"] <= 0).all()
