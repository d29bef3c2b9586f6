"""Attempts of legged robots played to their ends; results only, no recording is made."""

import numpy as np
from numpy.typing import NDArray

from pipeline.locomotion.robots import LeggedRobots
from pipeline.ppo.policy import check_fit
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.rollout import Result, rollout


def played(policy: Policy, robots: LeggedRobots, *, with_rewards: bool = False) -> Result:
    """Play each attempt until it truly falls or its time is up; `success` says which never fell.

    Raises:
        PolicyError: the policy was made for another robot or task.
    """
    check_fit(policy, robots.scenes[0].robot, robots.world.width, robots.world.action_size)
    policy.reset(robots.n)

    def over(tick: int, ids: Ids, observation: Observation, action: Array) -> NDArray[np.bool_]:
        del tick, observation, action
        return robots.fell[ids]

    return rollout(robots, policy, watch=over, until_success=False, with_rewards=with_rewards)
