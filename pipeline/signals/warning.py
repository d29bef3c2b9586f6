"""Early warning: one number out of two signals, the chance that an attempt fails as far as it has gone.

A logistic model on the logarithms of running means. Candidates are not asked: a trial fit with their spread
was no better (docs/results.md), and the number stays the same whoever rides.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pipeline.protocols import Array, Ids

WEIGHTS: MappingProxyType[str, float] = MappingProxyType({"distance": 4.18, "revision": 1.43})
"""Signal -> weight of the logarithm of its running mean. Fitted by `hardcase measure shadow` on twins 0-7."""
BIAS = -2.39
"""Same fit: champions of generation 0 at the deployment mix, and of generation 1 where half of the starts are rare."""
ALARM, ALARM_TICKS = 0.5, 5
"""Warning above which an attempt is more likely to fail than not, and ticks in a row until that is believed."""
FLOOR = 1e-3
"""Least mean that is told from nothing."""


class Running:
    """Running means of signals in n attempts; what is not finite is left out."""

    def __init__(self, n: int) -> None:
        self._n, self._sums, self._counts = n, dict[str, Array](), dict[str, Array]()

    def tick(self, signals: Mapping[str, Array], ids: Ids) -> dict[str, Array]:
        """Signal -> mean so far in the attempts of the tick, shape (len(ids),); NaN where it was never known."""
        means: dict[str, Array] = {}
        for name, values in signals.items():
            total = self._sums.setdefault(name, np.zeros(self._n))
            count = self._counts.setdefault(name, np.zeros(self._n))
            known = np.isfinite(values)
            total[ids] += np.where(known, values, 0.0)
            count[ids] += known
            means[name] = np.where(count[ids] > 0, total[ids] / np.maximum(count[ids], 1), np.nan)
        return means


def logarithms(means: Mapping[str, Array]) -> Array:
    """What the model sees of running means: one column a signal of WEIGHTS, in its order, shape (n, 2)."""
    return np.stack([np.log(np.maximum(means[name], FLOOR)) for name in WEIGHTS], axis=1)


def warning(means: Mapping[str, Array]) -> Array:
    """Chance of failure in [0, 1], shape (n,); NaN where one of the signals is not known yet.

    The chance is meant for a mix of starts as in the fit; its order, which is what AUROC measures, for any.
    """
    return 1 / (1 + np.exp(-(BIAS + logarithms(means) @ np.array([*WEIGHTS.values()]))))


def fit(columns: Array, failed: Array, *, ridge: float = 1.0) -> tuple[float, Array]:
    """Bias and weights of a logistic model by iteratively reweighted least squares.

    Args:
        columns: see `logarithms`, shape (n, k).
        failed: 1 where the attempt failed, else 0, shape (n,).
        ridge: penalty on squared weights, the bias left out.

    Source: Hastie, Tibshirani and Friedman 2009, The Elements of Statistical Learning, section 4.4.1.
    """
    known = np.isfinite(columns).all(axis=1)
    x, y = np.column_stack([np.ones(known.sum()), columns[known]]), failed[known]
    penalty = ridge * np.diag([0.0] + [1.0] * columns.shape[1])
    beta = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(x @ beta, -30, 30)))
        curve = x.T @ (x * (p * (1 - p))[:, None]) + penalty
        step = np.linalg.solve(curve, x.T @ (y - p) - penalty @ beta)
        beta = beta + step
        if np.abs(step).max() < 1e-9:
            break
    return float(beta[0]), beta[1:]
