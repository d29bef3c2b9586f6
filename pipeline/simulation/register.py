"""How Gymnasium learns of our environments; light, for the simulation is loaded when an environment is made."""

import gymnasium as gym

ID = "hardcase/PickPlace-v0"
TICKS = 150
"""Length limit of an attempt [ticks]: that of the task pick-place, whose module would load more than a name needs."""

LEGGED = {"hardcase/Stand-v0": "stand", "hardcase/Walk-v0": "walk"}
"""Environments of legged robots, by task; keyword `body` says whose."""
LEGGED_TICKS = 500
"""Length limit of their attempts [ticks]: that of both tasks."""


def register() -> None:
    """Make `gymnasium.make("hardcase/PickPlace-v0")` and `gymnasium.make_vec` work; a second call changes nothing.

    The same goes for the environments of legged robots: `gymnasium.make("hardcase/Stand-v0", body="unitree_h1")`.

    Gymnasium 1.x loads no plugins by itself: call this first, or name the module that does,
    `gymnasium.make("pipeline.simulation.registered:hardcase/PickPlace-v0")`.
    """
    if ID not in gym.registry:
        gym.register(  # pyright: ignore[reportUnknownMemberType]
            ID, entry_point="pipeline.simulation.gym_env:PickPlaceEnv", max_episode_steps=TICKS,
            vector_entry_point="pipeline.simulation.vector_env:PickPlaceVectorEnv")
    for name, task in LEGGED.items():
        if name not in gym.registry:
            gym.register(  # pyright: ignore[reportUnknownMemberType]
                name, entry_point="pipeline.locomotion.gym_env:LeggedEnv", max_episode_steps=LEGGED_TICKS,
                vector_entry_point="pipeline.locomotion.vector_env:LeggedVectorEnv", kwargs={"task": task})
