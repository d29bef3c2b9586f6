"""Cases: disagreements at which somebody was wrong become hard cases that say who and why."""

from collections.abc import Iterable

from pipeline.files import short_id
from schemas.counterfactual import Judgement
from schemas.hardcase import HardCase

DISAGREEMENT = "disagreement"
"""In the place of a trigger."""

ORDER = ("champion", "both", "candidate")
"""Whose mistakes are corrected first: the champion's are made at work."""


def cases_of(judgements: Iterable[Judgement], generation: int, arm: str = "") -> list[HardCase]:
    """A hard case for every judgement that found somebody wrong for certain, the champion's mistakes first.

    Its family is how the wrong policy mostly failed (the champion, where both were wrong), its tick where both
    still stood alike: a correction begins there.

    Args:
        judgements: of deployed attempts.
        generation: lap of the loop.
        arm: name of the arm of a study; its hard cases are its own.
    """
    made = [HardCase(id=short_id("hard case", j.id, arm), episode=j.episode, trigger=DISAGREEMENT, tick=j.tick,
                     family=why(j), stratum=j.stratum, generation=generation, wrong=j.wrong, judgement=j)
            for j in judgements if j.wrong is not None]
    return sorted(made, key=lambda c: (ORDER.index(str(c.wrong)), c.id))


def why(judgement: Judgement) -> str:
    """How the wrong policy mostly failed; the champion where both were wrong."""
    side = judgement.candidate if judgement.wrong == "candidate" else judgement.champion
    return str(side.main_reason)
