"""Our environment as lerobot knows it, so that lerobot's own command runs a checkpoint of ours:

    lerobot-eval --policy.path=CHECKPOINT --env.discover_packages_path=pipeline.policies --env.type=hardcase \\
        --eval.n_episodes=200 --eval.batch_size=50 --eval.use_async_envs=false --seed=1000 --output_dir=OUTPUT

Run it where `pipeline` can be imported: with PYTHONPATH at the repository, or with Hardcase installed. The one
discover_packages_path finds the policy too: it imports every module of the package, and lerobot 0.6.1 takes
--policy.discover_packages_path together with --policy.path for an option of the policy and stops. Episode k
starts from `reset(seed=1000 + k)`; OUTPUT/eval_info.json lists the success of each, and the first ten are
filmed, which cannot be turned off.

This is the one file of ours with lerobot's `register_subclass` for environments.
"""

from dataclasses import dataclass, field
from typing import Any, override

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature  # pyright: ignore[reportMissingTypeStubs]
from lerobot.envs.configs import EnvConfig  # pyright: ignore[reportMissingTypeStubs]
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE  # pyright: ignore[reportMissingTypeStubs]

from pipeline import frames
from pipeline.simulation.register import TICKS, register


@EnvConfig.register_subclass("hardcase")  # pyright: ignore[reportUnknownMemberType]
@dataclass
class HardcaseEnv(EnvConfig):
    """The Gymnasium environment `hardcase/PickPlace-v0`, state only."""

    task: str | None = "PickPlace-v0"
    fps: int = 20
    episode_length: int = TICKS
    """Length limit of an attempt [ticks]; the environment itself never lets one last longer than the task does."""
    render_mode: str = "rgb_array"
    """lerobot-eval films the first ten episodes whatever it is told."""
    features: dict[str, PolicyFeature] = field(default_factory=lambda: {
        ACTION: PolicyFeature(FeatureType.ACTION, (len(frames.ACTION),)),
        "agent_pos": PolicyFeature(FeatureType.STATE, (len(frames.STATE),)),
        "environment_state": PolicyFeature(FeatureType.ENV, (len(frames.ENVIRONMENT),)),
    })
    features_map: dict[str, str] = field(default_factory=lambda: {
        ACTION: ACTION, "agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE,
    })

    @property
    @override
    def gym_id(self) -> str:
        """Id in Gymnasium's registry."""
        return f"hardcase/{self.task}"

    @property
    @override
    def gym_kwargs(self) -> dict[str, Any]:
        """What gymnasium.make is told besides the id."""
        return {"max_episode_steps": self.episode_length, "render_mode": self.render_mode}

    @override
    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """lerobot's vector environment; registers ours first where Hardcase is not installed."""
        if self.gym_id not in gym.registry:
            register()
        return super().create_envs(n_envs, use_async_envs)
