"""How Gymnasium learns of our environment; light, for the simulation is loaded when an environment is made."""

import gymnasium as gym

ID = "hardcase/PickPlace-v0"
TICKS = 150
"""Length limit of an attempt [ticks]: that of the task pick-place, whose module would load more than a name needs."""


def register() -> None:
    """Make `gymnasium.make("hardcase/PickPlace-v0")` and `gymnasium.make_vec` work; a second call changes nothing.

    Gymnasium 1.x loads no plugins by itself: call this first, or name the module that does,
    `gymnasium.make("pipeline.simulation.registered:hardcase/PickPlace-v0")`.
    """
    if ID not in gym.registry:
        gym.register(  # pyright: ignore[reportUnknownMemberType]
            ID, entry_point="pipeline.simulation.gym_env:PickPlaceEnv", max_episode_steps=TICKS,
            vector_entry_point="pipeline.simulation.vector_env:PickPlaceVectorEnv")
