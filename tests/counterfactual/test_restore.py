"""A moment is judged only where restoring it and replaying the recorded commands gives the recording, bit for bit."""

from dataclasses import replace

import pytest

from pipeline.counterfactual.moment import Lab
from pipeline.counterfactual.restore import faults
from pipeline.counterfactual.ride import ride
from pipeline.simulation.bodies import Flex, arm
from pipeline.simulation.model import compose
from pipeline.simulation.scenes import Contact


def spoiled(moment, name, tick, column=0):
    """The moment of a recording of which one value was changed a little."""
    array = getattr(moment.trace, name).copy()
    array[tick, column] += 1e-9
    return replace(moment, trace=replace(moment.trace, **{name: array}))


def test_every_recorded_moment_comes_back_to_the_bit(moments_at, attempts, lab):
    last = len(attempts[3][1]) - 1
    assert faults(moments_at(attempts, [0, 1, 30, last]), lab) == [None] * 4


@pytest.mark.parametrize(("name", "says"), [
    ("sim_state", "the engine's state differs at tick 20"),
    ("controller", "the controller's state differs at tick 20"),
    ("state", "observation.state differs at tick 20"),
    ("environment", "observation.environment_state differs at tick 20"),
    ("action", "differs at tick 21"),
])
def test_a_tampered_recording_is_refused_and_the_others_are_not(moments_at, attempts, lab, name, says):
    moments = moments_at(attempts, [10, 10, 10, 10])
    found = faults([spoiled(moments[0], name, 20), *moments[1:]], lab)
    assert found[0].startswith("replaying the recorded commands does not give the recording") and says in found[0]
    assert found[1:] == [None] * 3


def test_a_tampered_moment_is_refused(moments_at, attempts, lab):
    moment = moments_at(attempts, [10] * 4)[0]
    engine = moment.engine.copy()
    engine[1] += 1e-12
    assert "the engine's state differs at tick 10" in faults([replace(moment, engine=engine)], lab)[0]


def test_another_engine_setting_is_refused(moments_at, attempts):
    other = Lab(compose(arm(), "table", Contact(elliptic=True, impratio=3.0)))
    assert all("does not give the recording" in str(w) for w in faults(moments_at(attempts, [0] * 4), other))


def test_another_robot_is_refused_before_it_is_loaded(moments_at, attempts):
    bending = Lab(compose(arm(flex=Flex(stiffness=200.0, damping=1.0)), "table", nominal=arm()))
    assert "another model was recorded" in faults(moments_at(attempts, [0] * 4), bending)[0]


def test_a_recording_without_a_simulators_state_is_refused(moments_at, attempts, lab):
    real, *others = moments_at(attempts, [0] * 4)
    bare = replace(real, engine=real.engine[:0], controller=real.controller[:0])
    found = faults([bare, *others], lab)
    assert found == ["no state of a simulator was recorded that could be put back", None, None, None]


def test_a_policy_that_rides_along_a_recording_does_what_it_did_and_remembers_what_it_knew(aiming, attempts, same):
    for (_, trace), found in zip(attempts, ride(aiming(), [t for _, t in attempts]), strict=True):
        assert same(found.action, trace.action)
        assert same(found.memory[1:], trace.controller[:-1, -3:])
        assert not found.memory[0].any()


def test_attempts_of_another_policy_are_refused(judged, attempts, aiming):
    found = judged(attempts, aiming(0.005), aiming(0.05))
    assert not found.judgements
    assert {r.reason for r in found.refusals} == {f"policy {'c' * 16} does not give the recorded action of tick 0"}
