"""How much each episode of a derived version weighs: groups keep their shares, single episodes have factors."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.lerobot_view.draft import free_name


class Weighed(NamedTuple):
    """The weights of a version."""

    groups: list[str]
    """Of every episode; a group whose episodes have different factors has become several."""
    weights: NDArray[np.float64]
    """Chance that a training sample comes from an episode; 0 if it is held out, shape (episodes,)."""
    shares: dict[str, float]
    """Group -> share of each batch, over the groups that train; they add up to 1."""


def weighed(groups: Sequence[str], train: NDArray[np.bool_], taught: NDArray[np.int64],
            factors: NDArray[np.float64], shares: Mapping[str, float]) -> Weighed:
    """Weights in which a group keeps its share and its frames are drawn evenly, but for the factors.

    A loader knows groups alone, and draws the frames of a group evenly; so episodes that are drawn more often
    than others of their group become a group of their own.

    Args:
        groups: of every episode.
        train: whether it is in the training split, shape (episodes,).
        taught: frames that a policy learns from, shape (episodes,).
        factors: how many times as often as the others of its group it is drawn, shape (episodes,).
        shares: group -> share; may hold more groups, and need not add up to 1.

    Raises:
        DatasetError: nothing is left to train on.
    """
    if not train.any():
        raise DatasetError("every episode that is left is held out", where=f"{len(groups)} episodes",
                           mend="keep at least one episode whose split is train")
    keys: list[tuple[str, float]] = list(zip(groups, map(float, factors), strict=True))
    names = _names(dict.fromkeys(keys), shares)
    split = [names[key] for key in keys]
    frames, whole = Counter[str](), Counter[str]()
    for k in map(int, np.flatnonzero(train)):
        frames[split[k]] += int(taught[k])
        whole[groups[k]] += int(taught[k])
    raw = {names[g, f]: shares[g] * f * (frames[names[g, f]] / whole[g]) for g, f in dict.fromkeys(keys) if whole[g]}
    total = sum(raw.values())
    result = {name: share / total for name, share in raw.items() if frames[name]}
    each = {name: share / frames[name] for name, share in result.items()}
    weights = np.array([each.get(name, 0.0) for name in split], np.float64) * taught.astype(np.float64) * train
    return Weighed(split, weights, result)


def _names(keys: Mapping[tuple[str, float], None], shares: Mapping[str, float]) -> dict[tuple[str, float], str]:
    """(Group, factor) -> name: the group's own where all have one factor, or where the factor is 1."""
    several = {g for g, _ in keys if len({f for h, f in keys if h == g}) > 1}
    taken: set[str] = {*shares, *(g for g, _ in keys)}
    names: dict[tuple[str, float], str] = {}
    for group, factor in keys:
        name = group if group not in several or factor == 1 else free_name(f"{group} x{factor:g}", taken)
        taken.add(name)
        names[group, factor] = name
    return names
