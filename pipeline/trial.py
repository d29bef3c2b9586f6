"""A trial: policies play the same scenes, piece by piece, and their outcomes are kept in order."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import GateError
from pipeline.files import short_id
from schemas.scene import SceneSpec

type Outcomes = NDArray[np.bool_]
type Scenes = Callable[[int, int], Sequence[SceneSpec]]
"""(start, stop) -> scenes start..stop of one fixed sequence of gate scenes."""
type Evaluate = Callable[[str, Sequence[SceneSpec]], Outcomes]
"""(policy id, scenes) -> solved or not, shape (len(scenes),), in their order."""
type Progress = Callable[[int, int], None]
"""Told (scenes played, scenes at most)."""


class Trial:
    """The gate scenes played so far and what each policy did with them.

    Args:
        candidate, champion: who plays; the champion may be missing, or be the candidate itself.
        scenes: where they come from.
        evaluate: how they are played.
    """

    def __init__(self, candidate: str, champion: str | None, scenes: Scenes, evaluate: Evaluate) -> None:
        self.candidate, self.champion = candidate, champion
        self.labels: list[str] = []
        """Stratum of each scene played."""
        self.written: list[str] = []
        """The scenes played, as JSON: causes of the verdict."""
        self.solved: dict[str, Outcomes] = {p: np.zeros(0, np.bool_) for p in (candidate, champion) if p is not None}
        self._scenes, self._evaluate = scenes, evaluate

    def play(self, stop: int) -> None:
        """Let every policy play the scenes up to `stop`.

        Raises:
            GateError: scenes are missing, repeated, or not of the gate's own family; outcomes do not fit the scenes.
        """
        start = len(self.labels)
        fresh = self._scenes(start, stop)
        where = f"gate scenes {start}..{stop}"
        if len(fresh) != stop - start:
            raise GateError(f"{len(fresh)} scenes instead of {stop - start}", where=where,
                            mend="the scene source must give scenes start..stop of one endless sequence")
        if strange := [s for s in fresh if s.family != "gate" or s.twin is not None]:
            raise GateError(f"a {strange[0].family} scene with twin {strange[0].twin} among the gate's", where=where,
                            mend="draw gate scenes from the family 'gate', in simulation, never from a twin")
        written = [scene.model_dump_json() for scene in fresh]
        if len({*self.written, *written}) != stop:
            raise GateError("a scene is played twice", where=where, mend="give each gate scene a seed of its own")
        for policy in self.solved:
            self.solved[policy] = np.concatenate([self.solved[policy], outcomes(self._evaluate, policy, fresh, where)])
        self.labels += [scene.stratum for scene in fresh]
        self.written += written

    def verdict_id(self, generation: int, *causes: str) -> str:
        """Identity by causes: who, on which scenes, by which thresholds."""
        return short_id("verdict", self.candidate, self.champion, generation, *causes, *self.written)


def outcomes(evaluate: Evaluate, policy: str, scenes: Sequence[SceneSpec], where: str) -> Outcomes:
    """What one policy did with some scenes, after a look at the shape of the answer.

    Raises:
        GateError: not one boolean a scene.
    """
    solved = np.asarray(evaluate(policy, scenes))
    if solved.shape != (len(scenes),) or solved.dtype != np.bool_:
        raise GateError(f"outcomes {solved.dtype}{list(solved.shape)} for {len(scenes)} scenes",
                        where=f"{where}, policy {policy}", mend="return one boolean a scene, in their order")
    return solved
