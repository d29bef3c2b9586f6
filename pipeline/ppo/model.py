"""SB3's PPO out of a config, and its whole state as numbers and arrays, for checkpoints that resume bit for bit."""

# SB3 and torch are only partly typed, and a resumed training has to reach into SB3's counters
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportPrivateUsage=false, reportUnknownParameterType=false

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pipeline.ppo.config import PpoConfig

type Parts = dict[str, dict[str, NDArray[Any]]]
"""Part of a checkpoint -> name -> array."""


def ppo_model(env: VecEnv, config: PpoConfig, seed: int, *, activation: type[nn.Module] = nn.ELU,
              orthogonal: bool = True) -> PPO:
    """SB3's PPO with these numbers; torch's and numpy's own generators are seeded, which it draws from.

    Args:
        env: what it acts in.
        config: the numbers; `reward_scale` is the environment's business.
        seed: of weights, draws and starts.
        activation: between the layers.
        orthogonal: whether weights begin orthogonal, as SB3 has it by default.
    """
    def rate(left: float) -> float:
        return config.learning_rate * (config.last_rate + (1 - config.last_rate) * left)

    network: Mapping[str, Any] = {"net_arch": list(config.hidden), "activation_fn": activation,
                                  "log_std_init": config.log_std, "ortho_init": orthogonal}
    return PPO("MlpPolicy", env, learning_rate=rate, n_steps=config.ticks,
               batch_size=min(config.batch, config.iteration), n_epochs=config.epochs,
               gamma=config.gamma, gae_lambda=config.gae_lambda, clip_range=config.clip, ent_coef=config.entropy,
               vf_coef=config.value, max_grad_norm=config.gradient, policy_kwargs=dict(network), seed=seed,
               device="cpu")


def model_state(model: PPO) -> tuple[dict[str, Any], Parts]:
    """Counters and schedules as JSON, arrays by part; at a moment between an update and the next collection."""
    optimiser: dict[str, Any] = model.policy.optimizer.state_dict()
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)  # noqa: NPY002
    facts: dict[str, Any] = {
        "steps": model.num_timesteps, "updates": model._n_updates, "episodes": model._episode_num,
        "progress_left": model._current_progress_remaining, "optimiser_groups": optimiser["param_groups"],
        "numpy": [name, int(position), int(has_gauss), float(gauss)]}
    assert model._last_obs is not None and model._last_episode_starts is not None
    arrays: Parts = {
        "weights": {k: v.detach().numpy().copy() for k, v in model.policy.state_dict().items()},
        "optimiser": {f"{i}/{k}": v.numpy().copy() for i, one in optimiser["state"].items() for k, v in one.items()},
        "generators": {"torch": torch.get_rng_state().numpy().copy(), "numpy": np.asarray(keys)},
        "last": {"observation": np.asarray(model._last_obs), "starts": np.asarray(model._last_episode_starts)}}
    return facts, arrays


def restore_model(model: PPO, facts: Mapping[str, Any], arrays: Parts) -> None:
    """Go on from what `model_state` gave; KeyError, ValueError, RuntimeError or TypeError if it lacks something."""
    model.policy.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in arrays["weights"].items()})
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key, values in arrays.get("optimiser", {}).items():
        number, name = key.split("/")
        state.setdefault(int(number), {})[name] = torch.from_numpy(values.copy())
    model.policy.optimizer.load_state_dict({"state": state, "param_groups": facts["optimiser_groups"]})
    model._last_obs, model._last_episode_starts = arrays["last"]["observation"], arrays["last"]["starts"]
    model.num_timesteps, model._n_updates = facts["steps"], facts["updates"]
    model._episode_num, model._current_progress_remaining = facts["episodes"], facts["progress_left"]
    torch.set_rng_state(torch.from_numpy(arrays["generators"]["torch"].copy()))
    name, position, has_gauss, gauss = facts["numpy"]
    np.random.set_state((name, arrays["generators"]["numpy"], position, has_gauss, gauss))  # noqa: NPY002
