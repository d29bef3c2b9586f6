"""Plans tried a CPU second by predictive sampling on Batch, beside a plain loop. Run: pytest -s tests/bench_control.py

The same candidates, physics and costs both ways: what a user would write otherwise is one MjData and `mj_step`, plan
after plan, in Python. CPU time of the process, median of turns that alternate.
"""

import time
from statistics import median

import mujoco
import numpy as np

from pipeline.control.arm import ArmPlant
from pipeline.control.arm_model import EFFORT_M, SMOOTH_M, SWING_M, TURN_M, ArmModel, apart
from pipeline.control.config import SamplingConfig
from pipeline.control.reaches import draw_reaches
from pipeline.simulation.world import OPEN_M

ROBOTS, ROUNDS = 20, 5
CONFIG = SamplingConfig()


def test_plans_a_cpu_second():
    """20 arms, 16 plans each of 25 steps, scored by distance, turn and effort."""
    plant = ArmPlant(draw_reaches(ROBOTS, 0, perturbed=False))
    model, sensed = ArmModel(plant.setup.body, ROBOTS, CONFIG), plant.sense()
    noise = np.random.default_rng(0).normal(0, 0.2, (ROBOTS, CONFIG.samples, 1, 6))
    actions = np.clip(plant.home + noise, model.low, model.high).repeat(CONFIG.steps, axis=2)
    ours, plain, loop = [], [], Loop(plant)
    for _ in range(ROUNDS):
        began = time.process_time()
        batched = model.costs(sensed, plant.goals, actions)
        middle = time.process_time()
        looped = loop.costs(sensed, plant.goals, actions)
        ours.append(middle - began)
        plain.append(time.process_time() - middle)
    assert np.allclose(batched, looped, rtol=1e-9)
    plans, ratio = ROBOTS * CONFIG.samples, median(plain) / median(ours)
    print(f"\nBatch: {plans / median(ours):,.0f} plans a CPU second, {plans * CONFIG.steps / median(ours):,.0f} steps; "
          f"loop over mj_step: {plans / median(plain):,.0f}; {ratio:.1f} times as many")
    assert ratio > 1


class Loop:
    """What a user would write."""

    def __init__(self, plant):
        spec = plant.setup.body.spec.copy()
        spec.option.timestep = CONFIG.step_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.site = self.model.site("tool").id

    def costs(self, sensed, goals, actions):
        model, data = self.model, self.data
        limit = model.actuator_forcerange[:6, 1]
        costs = np.zeros(actions.shape[:2])
        for i in range(len(actions)):
            for k in range(actions.shape[1]):
                mujoco.mj_resetData(model, data)
                data.qpos[:6], data.qvel[:6], data.qpos[6:] = sensed.joints[i], sensed.speeds[i], OPEN_M / 2
                total = 0.0
                for action in actions[i, k]:
                    data.ctrl[:6], data.ctrl[6] = action, OPEN_M / 2
                    mujoco.mj_step(model, data)
                    away, turn = apart(data.site_xpos[self.site], data.site_xmat[self.site], goals[i])
                    effort = np.mean((data.actuator_force[:6] / limit) ** 2)
                    total += np.sqrt(away**2 + SMOOTH_M**2) + TURN_M * turn + EFFORT_M * effort
                costs[i, k] = total / len(actions[i, k]) + SWING_M * np.sqrt(np.mean(data.qvel[:6] ** 2))
        return costs
