"""Regression scenes: how often equal policies would be told apart by them."""

import numpy as np
from scipy.special import bdtr  # pyright: ignore[reportMissingTypeStubs]


def chance_of_a_veto(scenes: int, seeds: int, lost: int) -> float:
    """Upper bound of the chance that equal policies seem to have lost one of so many scenes.

    A scene that both solve with probability p seems lost with p^seeds P(Bin(seeds, p) <= lost): always solved by the
    one, hardly ever by the other, independently. It is lost where that is seen twice, so this is squared. The bound
    takes the p at which that is largest for every scene, and adds up; scenes that are nearly always or hardly ever
    solved come nowhere near it.

    Args:
        scenes: regression scenes.
        seeds: times that each is played by each policy, and again where it seems lost.
        lost: successes of the candidate at which a scene is lost.
    """
    p = np.linspace(0, 1, 2001)
    return float(min(1.0, scenes * ((p**seeds * bdtr(lost, seeds, p)) ** 2).max()))
