"""Randomized physics: each name changes what it says and nothing else, and draws travel as they are."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.simulation.physics import MAX_DELAY, NOMINAL, RANDOMIZATIONS, UNITS, from_draws, randomize
from schemas.scene import Draw

FIELDS = ("actuator_gainprm", "actuator_biasprm", "dof_damping", "dof_frictionloss", "dof_armature", "geom_friction",
          "geom_size", "body_mass", "body_inertia", "jnt_range", "jnt_stiffness", "geom_solref", "geom_solimp",
          "actuator_forcerange", "body_pos")
CHANGES = {
    "kp": (1.2, {"actuator_gainprm", "actuator_biasprm"}), "damping": (1.4, {"dof_damping"}),
    "frictionloss": (2.0, {"dof_frictionloss"}), "friction": (0.7, {"geom_friction"}),
    "mass": (0.1, {"body_mass", "body_inertia"}), "tilt_x": (0.02, {"gravity"}), "tilt_y": (-0.02, {"gravity"}),
    "delay": (2.0, set()), "backlash": (0.01, set()), "bias_x": (0.01, set()), "bias_y": (0.01, set()),
    "noise": (0.001, set()), "jitter": (0.2, set()), "stiction": (1.0, set()),
}
"""Parameter -> a value unlike the nominal one, and the fields of the model that it changes."""


def values(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    return {**{name: getattr(model, name).copy() for name in FIELDS}, "gravity": model.opt.gravity.copy()}


@pytest.mark.parametrize("name", CHANGES)
def test_a_parameter_changes_its_own_fields_and_no_other(make_world, starts, name):
    value, expected = CHANGES[name]
    nominal, drawn = (values(make_world(starts(2), **p).batch.get_model(1)) for p in ({}, {name: value}))
    assert {k for k in nominal if not np.array_equal(nominal[k], drawn[k])} == expected


def test_every_parameter_is_looked_at():
    assert CHANGES.keys() == NOMINAL.keys() == UNITS.keys()
    assert RANDOMIZATIONS.keys() <= NOMINAL.keys()


def test_the_nominal_draw_is_the_compiled_model(setup, make_world, starts):
    compiled, nominal = values(setup.model), values(make_world(starts(1)).batch.get_model(0))
    for name, field in compiled.items():
        assert np.allclose(field, nominal[name], atol=1e-12), name


def test_factors_multiply_the_robots_joints_only(setup, make_world, starts):
    model = make_world(starts(1), kp=1.2, damping=1.4, frictionloss=2.0).batch.get_model(0)
    dofs = [setup.model.joint(name).dofadr[0] for name in setup.body.joints]
    others = np.setdiff1d(np.arange(model.nv), dofs)
    assert np.allclose(model.dof_damping[dofs], 1.4 * setup.model.dof_damping[dofs])
    assert np.allclose(model.dof_frictionloss[dofs], 2.0 * setup.model.dof_frictionloss[dofs])
    assert (model.dof_damping[others] == setup.model.dof_damping[others]).all()
    assert np.allclose(model.actuator_gainprm[:6, 0], 1.2 * setup.model.actuator_gainprm[:6, 0])
    assert model.actuator("gripper").gainprm[0] == setup.model.actuator("gripper").gainprm[0]


def test_a_larger_cube_has_the_inertia_of_a_larger_cube(make_world, starts):
    model = make_world(starts(1, "large")).batch.get_model(0)
    assert np.allclose(model.geom("object").size, 0.031)
    assert np.allclose(model.body("object").inertia, 0.05 * 0.062**2 / 6)


@given(st.dictionaries(st.sampled_from(sorted(NOMINAL)), st.floats(-10, 10), max_size=len(NOMINAL)))
def test_what_is_drawn_is_what_applies_and_the_rest_stays_nominal(chosen):
    drawn = [Draw(name=name, unit=UNITS[name], value=value) for name, value in chosen.items()]
    physics = from_draws([(), drawn])
    assert all(getattr(physics, name)[0] == NOMINAL[name] for name in NOMINAL)
    assert all(getattr(physics, name)[1] == chosen.get(name, NOMINAL[name]) for name in NOMINAL)


@given(st.integers(0, 2**32), st.floats(0.1, 3))
@settings(max_examples=50)
def test_training_draws_can_be_made_again_and_are_physical(seed, widen):
    drawn = randomize(np.random.default_rng(seed), widen)
    assert drawn == randomize(np.random.default_rng(seed), widen)
    assert [d.name for d in drawn] == list(RANDOMIZATIONS)
    value = {d.name: d.value for d in drawn}
    assert all(value[name] > 0 for name in ("kp", "damping", "friction", "mass"))
    assert all(value[name] >= 0 for name in ("frictionloss", "backlash", "noise"))
    assert value["delay"] in range(MAX_DELAY)


def test_wider_draws_spread_wider():
    def spread(widen: float) -> np.ndarray:
        rng = np.random.default_rng(0)
        return np.std([[d.value for d in randomize(rng, widen)] for _ in range(300)], axis=0)

    assert (spread(2.0) > 1.2 * spread(1.0)).all()


def test_training_knows_no_jitter_and_no_stiction():
    assert not {"jitter", "stiction"} & RANDOMIZATIONS.keys()
