"""LeggedTracer: what a recording of legged robots holds beside what one of any robot does."""

from typing import override

import numpy as np

from pipeline.locomotion.robots import LeggedRobots
from pipeline.locomotion.sensed import sensed
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.simulation.tracing import Tracer


class LeggedTracer(Tracer):
    """Keeps joints and IMU as they were measured; see pipeline.simulation.tracing.Tracer.

    Args:
        robots: the attempts.
    """

    def __init__(self, robots: LeggedRobots) -> None:
        super().__init__(robots, joints=robots.body.joints, torque=robots.body.control == "torque")
        self._body = robots.body

    @override
    def before(self, ids: Ids, observation: Observation, action: Array, policy: Policy) -> None:
        """Keep what is known before the action of this tick is sent."""
        now = sensed(observation.state, self._body)
        self.pend("joint_position", now.joints)
        self.pend("joint_velocity", now.rates)
        self.pend("imu", np.concatenate([now.upright, now.turning], axis=1))
        super().before(ids, observation, action, policy)
