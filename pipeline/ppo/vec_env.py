"""Vector environments of ours for SB3: what many episodes in one engine share, and AttemptsVecEnv."""

# SB3's base class is only partly typed
# pyright: reportUnknownMemberType=false, reportUnknownParameterType=false, reportMissingParameterType=false
# pyright: reportUnknownArgumentType=false, reportMissingTypeArgument=false, reportUnknownVariableType=false

from collections.abc import Iterable, Sequence
from typing import Any, override

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from pipeline.locomotion.attempts import Attempts
from pipeline.locomotion.spaces import action_space, observation_space
from pipeline.ppo.curves import Tally
from pipeline.ppo.normaliser import Normaliser
from pipeline.protocols import Array

type Indices = int | Iterable[int] | None


class EngineVecEnv(VecEnv):
    """Episodes that share one engine: SB3 may ask none of them on its own."""

    @override
    def close(self) -> None:
        pass

    @override
    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * len(self._which(indices))

    @override
    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        raise AttributeError(f"attempts share one engine; {attr_name} is not set one by one")

    @override
    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        raise AttributeError(f"attempts share one engine; {method_name} is not called one by one")

    @override
    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        return [False] * len(self._which(indices))

    def _which(self, indices: Indices) -> Sequence[int]:
        return list(self._get_indices(indices))


class AttemptsVecEnv(EngineVecEnv):
    """n attempts that begin anew by themselves; time's up is told apart from a fall, as SB3 asks.

    Args:
        attempts: what is done.
        reward_scale: what rewards are multiplied by on their way to SB3; the tally has them as they are.
    """

    def __init__(self, attempts: Attempts, reward_scale: float) -> None:
        self.attempts, self._scale = attempts, reward_scale
        self.normaliser, self.tally = Normaliser(attempts.world.width), Tally()
        self._action: Array = np.zeros((attempts.world.n, attempts.world.action_size))
        super().__init__(attempts.world.n, observation_space(attempts.world), action_space(attempts.world))

    @override
    def reset(self) -> NDArray[np.float32]:
        return self._seen(self.attempts.begin())

    @override
    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._action = actions.astype(np.float64)

    @override
    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        tick = self.attempts.step(self._action)
        self.tally.add(tick)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i, last in zip(tick.ended, self.normaliser(tick.last), strict=True):
            infos[i] = {"terminal_observation": last, "TimeLimit.truncated": bool(tick.late[i])}
        reward = (self._scale * tick.reward).astype(np.float32)
        return self._seen(tick.observation), reward, tick.fallen | tick.late, infos

    def _seen(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        self.normaliser.update(rows)
        return self.normaliser(rows)
