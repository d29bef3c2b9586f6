"""What the cameras of the robot at work see: for a policy that sees, and for what is recorded of its attempts."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from pipeline.files import sha256_file
from pipeline.protocols import Policy, SeeingPolicy
from pipeline.recording.copying import add_pictures
from pipeline.simulation.eyes import Eyes, with_eyes
from pipeline.simulation.recordings import Recorded
from pipeline.simulation.world import World
from pipeline.twin.look import twin_look
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.recipe import Recipe
from stages.deploy import Sight

FOLDER = "seen"
"""Below the folder of the recordings, where they are written again with pictures."""


def sight_of(policy: Policy, twin: int) -> Sight | None:
    """What a stage drives the policy through; None for one that does not see."""
    if not isinstance(policy, SeeingPolicy):
        return None

    def sight(driver: Policy, world: World) -> AbstractContextManager[Policy]:
        return with_eyes(driver, world, [twin_look(twin)] * world.n, policy)

    return sight


def filmed(recorded: Sequence[Recorded], recipe: Recipe, twin: int) -> list[Recorded]:
    """The recordings with what the robot's cameras saw at every tick; as they are where the recipe renders no camera.

    Pictures are rendered after the attempt from the states it was in: the very pixels that a policy was shown, as JPEG.

    Raises:
        ConfigError: the scene has no camera of that name.
        SimulationError: nothing can render here.
    """
    cameras = {name: c for name, c in recipe.dataset.cameras.items() if c.rendered}
    for name, config in cameras.items():
        xml = twin_setup(draw_twin(twin), recipe.robot, recipe.scene).xml
        with Eyes(xml, (name,), width=int(config.width or 0), height=int(config.height or 0)) as eyes:
            recorded = [_filmed(one, name, eyes, twin) for one in recorded]
    return list(recorded)


def _filmed(one: Recorded, camera: str, eyes: Eyes, twin: int) -> Recorded:
    half_m, looks = np.array([one.episode.scene.object_half_m]), [twin_look(twin)]
    target = one.path.parent / FOLDER / camera / one.path.name
    _again(target)
    add_pictures(one.path, target, lambda state: {camera: eyes.see(state[None], half_m, looks)[camera][0]}, (camera,))
    return Recorded(one.episode.model_copy(update={"blob": sha256_file(target)}), target)


def _again(target: Path) -> None:
    """What a killed run left there is overwritten."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
