"""Mine: which failures went alike, in which subtask each went wrong, and which corrections are worth most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.files import short_id
from pipeline.mining.families import join
from pipeline.mining.happened import FEATURES, Sensed, Starts, described, sensed, subtask
from pipeline.mining.names import named, told
from pipeline.mining.order import Failures, Turn, failing, queue
from pipeline.protocols import Array
from pipeline.trace import Trace
from schemas.hardcase import HardCase
from schemas.mining import Family, Ranked

PRIOR, PRIOR_TRIES = 0.8, 2.0
"""Chance that a correction ends the failures that it is made for, before laps have shown it, and what that weighs."""


def nowhere() -> Starts:
    """No start at all."""
    return np.zeros((0, 3))


@dataclass(frozen=True, slots=True)
class Before:
    """What is known when a lap's failures are looked at."""

    families: tuple[Family, ...] = ()
    """Of earlier laps."""
    taught: Starts = field(default_factory=nowhere)
    """Starts that the policy at work learnt from, shape (n, 3)."""
    corrected: Starts = field(default_factory=nowhere)
    """Those among them of corrections, and of corrections that are still to be learnt from, shape (m, 3)."""
    tries: Mapping[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])
    """Family id -> corrections made in earlier laps, and how many of their starts a release has solved since."""


@dataclass(frozen=True, slots=True)
class Mined:
    """Failures of one lap, told apart and put in order."""

    cases: tuple[HardCase, ...]
    """As they came, each with its family and the subtask in which it went wrong."""
    new: tuple[Family, ...]
    """Families that no earlier lap has shown."""
    queue: tuple[Ranked, ...]
    """Every case, the one whose correction is worth most first."""


def mine(cases: Sequence[HardCase], traces: Mapping[str, Trace], before: Before, *, solved: Starts, generation: int,
         run: str = "") -> Mined:
    """Group the failures of a lap by what happened, and order their corrections by expected value.

    Args:
        cases: hard cases of one lap.
        traces: episode id -> recording, of every case.
        before: what earlier laps have shown.
        solved: starts of the lap's attempts that nothing was noticed of, shape (m, 3): with the cases, all attempts.
        generation: of the lap.
        run: families of one run are its own.
    """
    seen = [sensed(traces[case.episode], before.taught) for case in cases]
    points = np.array([described(s) for s in seen]).reshape(len(seen), len(FEATURES))
    joined = join(points, _points(before.families))
    families = list(before.families)
    for row in joined.medoids:
        families.append(_family(cases[row], seen[row], points[row], families, generation, run))
    told_apart = tuple(_attributed(case, s, families[int(joined.family[i])])
                       for i, (case, s) in enumerate(zip(cases, seen, strict=True)))
    chance = [chance_of(*before.tries.get(f.id, (0, 0))) for f in families]
    starts = np.array([s.start for s in seen]).reshape(len(seen), 3)
    failures = Failures(starts, np.array([s.unlike_m for s in seen]), joined.family, failing(starts, solved),
                        np.array(chance, np.float64)[joined.family])
    ranked = tuple(_ranked(turn, told_apart, families, failures, len(cases) + len(solved))
                   for turn in queue(failures, before.corrected))
    return Mined(told_apart, tuple(families[len(before.families):]), ranked)


def chance_of(tries: int, fixed: int) -> float:
    """That a correction ends the failures that it is made for: the prior, moved by what earlier laps have shown."""
    return (PRIOR * PRIOR_TRIES + fixed) / (PRIOR_TRIES + tries)


def _points(families: Sequence[Family]) -> Array:
    """Medoids as rows; a feature that a family was found without tells nothing apart."""
    rows = [[f.point.get(name, np.nan) for name in FEATURES] for f in families]
    return np.array(rows, np.float64).reshape(len(rows), len(FEATURES))


def _family(case: HardCase, s: Sensed, point: Array, others: Sequence[Family], generation: int, run: str) -> Family:
    return Family(id=short_id("family", run, case.episode), name=named(s, [f.name for f in others]),
                  medoid=case.episode, says=told(s), subtask=subtask(s)[0], generation=generation,
                  point=dict(zip(FEATURES, map(float, point), strict=True)))


def _attributed(case: HardCase, s: Sensed, family: Family) -> HardCase:
    name, tick = subtask(s)
    return case.model_copy(update={"found": family.id, "subtask": name, "begins": tick})


def _ranked(turn: Turn, cases: Sequence[HardCase], families: Sequence[Family], failures: Failures,
            attempts: int) -> Ranked:
    case, count = cases[turn.row], int((failures.family == failures.family[turn.row]).sum())
    family = next(f for f in families if f.id == case.found)
    per_1000 = 1000 * turn.worth / max(1, attempts)
    again, chance = float(failures.again[turn.row]), float(failures.chance[turn.row])
    reason = (f"{count} of {attempts} attempts failed as {family.name}; {100 * again:.0f} % fail that begin so, chance "
              f"{chance:.2f}, new {turn.novelty:.2f}: ends {per_1000:.1f} failures in 1,000 attempts")
    if turn.folds:
        reason += f"; stands for {len(turn.folds)} more that began alike"
    return Ranked(case=case.id, episode=case.episode, family=family.id, worth=turn.worth, per_1000=per_1000,
                  again=again, chance=chance, novelty=turn.novelty,
                  folds=tuple(cases[k].id for k in turn.folds), reason=reason)
