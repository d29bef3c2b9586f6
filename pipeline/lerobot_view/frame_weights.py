"""How often each frame of a version is drawn: the shares of its groups, times factors by where a frame comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError

type Labels = Mapping[str, NDArray[np.str_]]
"""source, family, outcome, segment -> that of each frame, shape (n,)."""


@dataclass(frozen=True, slots=True)
class Factors:
    """Factors on the chance of a frame, by name; a name that is not listed counts 1, 0 leaves its frames out."""

    source: Mapping[str, float] = field(default_factory=dict[str, float])
    """Origin of the episode: scripted, corrected, ..."""
    family: Mapping[str, float] = field(default_factory=dict[str, float])
    """Family of the failure that it ended in; '' for a success."""
    outcome: Mapping[str, float] = field(default_factory=dict[str, float])
    """success, failure, unknown."""
    segment: Mapping[str, float] = field(default_factory=dict[str, float])
    """Who commanded the frame: demonstration, autonomous, intervention."""

    def of(self, labels: Labels, where: object) -> NDArray[np.float64]:
        """The factor of every frame, shape (n,).

        Raises:
            ConfigError: a factor below 0 or not finite, or a name that no frame has: it would silently do nothing.
        """
        found = np.ones(len(labels["source"]))
        for kind in (f.name for f in fields(self)):
            wanted: Mapping[str, float] = getattr(self, kind)
            there = np.unique(labels[kind])
            for name, factor in wanted.items():
                if not 0 <= factor < np.inf:
                    raise ConfigError(f"factor {factor} of {kind} {name!r}", where=where, mend="give 0 or more")
                if name not in there:
                    raise ConfigError(f"no frame has the {kind} {name!r}", where=where,
                                      mend=f"use one of: {', '.join(repr(str(t)) for t in there)}")
                found[labels[kind] == name] *= factor
        return found


def chances(groups: Mapping[str, NDArray[np.intp]], shares: Mapping[str, float], factor: NDArray[np.float64],
            where: object) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Rows that may be drawn, in order, and the rising sum of their chances, which ends at 1.

    Within a group frames are drawn evenly before the factors; a group's share is what it has of all before them.

    Raises:
        ConfigError: the factors leave nothing.
    """
    rows = np.concatenate(list(groups.values()))
    chance = np.concatenate([np.full(g.size, shares[name] / max(g.size, 1)) for name, g in groups.items()])
    order = np.argsort(rows, kind="stable")
    rows, chance = rows[order], chance[order] * factor[rows[order]]
    rows, chance = rows[chance > 0], chance[chance > 0]
    if not rows.size:
        raise ConfigError("the factors leave no frame to draw", where=where, mend="give a factor above 0 to something "
                                                                                 "that the version holds")
    total = np.cumsum(chance)
    return rows, total / total[-1]
