"""How well one measurement of policies (the gate, in simulation) foretells another (the exam, on the twin)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Prediction:
    """Agreement of two sets of success rates of the same policies."""

    policies: int
    pearson: float | None
    """Correlation; None where one side does not vary or fewer than 3 policies are known."""
    sign_agreement: float | None
    """Share of the pairs of policies, equal in neither, that both order the same way; None without such a pair."""
    rank_violation: float
    """Mean maximum rank violation: exam points at stake in the worst wrong ordering of a policy, on average."""


def predict_quality(predicted: Sequence[float], actual: Sequence[float]) -> Prediction:
    """Compare predicted with actual success rates of the same policies.

    pearson = cov(s, r) / (sd(s) sd(r)). Sign agreement is the share of pairs i < j with
    sign(s_i - s_j) = sign(r_i - r_j). Rank violation (MMRV) is the mean over i of
    max over j of |r_i - r_j| where (s_i < s_j) differs from (r_i < r_j).

    Args:
        predicted: s, rates at the gate, one a policy.
        actual: r, rates at the exam, the same policies in the same order.

    Raises:
        ConfigError: no policy, or the lengths differ.

    Source: Li et al. 2024, Evaluating Real-World Robot Manipulation Policies in Simulation (SIMPLER),
    arXiv 2405.05941, section IV (Pearson and MMRV).
    """
    s, r = np.asarray(predicted, np.float64), np.asarray(actual, np.float64)
    if s.shape != r.shape or s.ndim != 1 or s.size == 0:
        raise ConfigError(f"{s.size} predicted and {r.size} actual rates", where="prediction",
                          mend="give both rates of every policy, in one order")
    varies = s.size > 2 and np.ptp(s) > 0 and np.ptp(r) > 0
    i, j = np.triu_indices(s.size, 1)
    signs = np.sign(s[i] - s[j]), np.sign(r[i] - r[j])
    told = (signs[0] != 0) & (signs[1] != 0)
    wrong = (s[:, None] < s[None, :]) != (r[:, None] < r[None, :])
    return Prediction(
        policies=s.size,
        pearson=float(np.clip(np.corrcoef(s, r)[0, 1], -1, 1)) if varies else None,
        sign_agreement=float((signs[0] == signs[1])[told].mean()) if told.any() else None,
        rank_violation=float((np.abs(r[:, None] - r[None, :]) * wrong).max(axis=1).mean()),
    )
