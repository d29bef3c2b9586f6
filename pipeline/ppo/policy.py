"""LeggedPolicy: a policy of a legged robot as the rest of the loop knows policies, by ONNX Runtime alone."""

from pathlib import Path

import numpy as np

from pipeline.errors import PolicyError
from pipeline.ppo.runner import OnnxRunner
from pipeline.protocols import Array, Ids, Observation, Policy


class LeggedPolicy:
    """Implements pipeline.protocols.Policy: what is sensed goes in as `state`; it keeps no memory.

    Args:
        path: an ONNX file, see pipeline.ppo.export.
        threads: of ONNX Runtime; one, because the simulation uses the others.

    Raises:
        PolicyError: the file is hostile, damaged, a pickle, or no policy of a legged robot.
    """

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        self._runner, self._path = OnnxRunner(path, threads=threads), path

    @property
    def body(self) -> str | None:
        """The robot that it was trained on, as the file says."""
        return self._runner.facts.get("body")

    def must_fit(self, body: str, width: int, joints: int) -> None:
        """Raise PolicyError where it was made for another robot, or takes or gives other sizes than these."""
        runner = self._runner
        if self.body not in (None, body) or (runner.width, runner.joints) != (width, joints):
            raise PolicyError(
                f"policy of {self.body} ({runner.width} values, {runner.joints} joints) on {body} ({width} values, "
                f"{joints} joints)", where=self._path, mend=f"train one for it: hardcase rl train --body {body}")

    def reset(self, n: int) -> None:
        """Prepare for n attempts: there is nothing to forget."""

    def act(self, observation: Observation, ids: Ids) -> Array:
        """Shares in [-1, 1], shape (len(ids), joints), in the order of ids."""
        del ids
        return self._runner(observation.state.astype(np.float32))

    def memory(self, ids: Ids) -> Array:
        """Rows of no values."""
        return np.zeros((len(ids), 0))


def check_fit(policy: Policy, body: str, width: int, joints: int) -> None:
    """Raise PolicyError where a policy that knows its robot was made for another one; see LeggedPolicy.must_fit."""
    if isinstance(policy, LeggedPolicy):
        policy.must_fit(body, width, joints)
