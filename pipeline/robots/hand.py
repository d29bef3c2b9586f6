"""Hand: whoever commands a robot does it through this, so that nothing reaches it unchecked."""

import numpy as np

from pipeline.protocols import Array, LiveRobot, Observation
from pipeline.robots.limits import Guard, Limits
from pipeline.robots.mapping import Driver

_ONE = np.arange(1)


class Hand:
    """Sends what may be sent of an action.

    Args:
        robot: connected.
        driver: knows what keeps the robot still.
        limits: of the robot.
    """

    def __init__(self, robot: LiveRobot, driver: Driver, limits: Limits) -> None:
        self._robot, self._driver, self._limits = robot, driver, limits
        self._guard: Guard | None = None
        self.note = ""
        """What was wrong with the last action; empty where nothing was."""

    def act(self, action: Array, observation: Observation) -> None:
        """Check an action, send what is left of it, and let one control period pass.

        Raises:
            RobotError: see Guard.check; or the robot refuses.
        """
        hold = self._driver.hold(observation)
        if self._guard is None:
            self._guard = Guard(self._robot.name, self._robot.signals, self._limits, hold)
        checked = self._guard.check(action, hold)
        self.note = checked.note
        self._robot.act(checked.action[None], _ONE)
        self._driver.sent(checked.action)
