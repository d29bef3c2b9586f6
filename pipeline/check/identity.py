"""The same motion twice: duplicates, and episodes that the training and the validation split share."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.check.following import numbers, resample
from pipeline.check.signals import Rows, Signals, Subject
from pipeline.files import sha256
from schemas.contract import Contract, Thresholds
from schemas.finding import Finding

POINTS = 48
"""Moments at which two motions are compared, spread over each."""
BLOCK = 1024
"""Episodes compared at once with all others: keeps the table of distances at a few MB."""
SHOWN = 20
"""Findings that a check lists before it only counts."""
MAX_ROWS = 50_000
"""Rows of an episode that are compared one by one; 17 minutes at 50 Hz."""
STILL = 0.05
"""Share of the largest range that every column counts with at least."""
COMMON = 8
"""Episodes that share a row above which it says nothing: all begin in the same pose."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What is compared of an episode; a few KB, however long it is."""

    name: str
    lineage: str
    split: str
    shape: Rows
    """Measured and commanded columns at POINTS even places, shape (POINTS, d)."""
    digest: str
    """sha256 over all rows, to the bit of a float32."""
    rows: NDArray[np.uint64]
    """A hash of every row that differs from the one before it, of the first MAX_ROWS."""

    def plain(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {"name": self.name, "lineage": self.lineage, "split": self.split, "digest": self.digest,
                "shape": self.shape.tolist(), "rows": self.rows.tolist()}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "Motion":
        """The inverse of `plain`."""
        return cls(str(plain["name"]), str(plain["lineage"]), str(plain["split"]),
                   np.array(plain["shape"], np.float64), str(plain["digest"]), np.array(plain["rows"], np.uint64))


@dataclass(frozen=True, slots=True)
class Twins:
    """Two episodes with the same motion."""

    first: int
    second: int
    what: str
    """How the second is like the first: '... episode 3'."""
    distance: float
    """0 where they are equal to the bit; else the distance, or the share of rows that differ."""


def motion_of(signals: Signals, contract: Contract) -> Motion | None:
    """The motion of an episode, from the first pair of the contract that it has; None where it has none."""
    for pair in contract.motion:
        measured, commanded = signals.find(pair.measured), signals.find(pair.commanded)
        if measured is not None and commanded is not None and len(measured[0]) > 1 and len(commanded[0]) > 1:
            own, theirs = measured[2].rows, commanded[2].rows
            if len(own) != len(theirs):
                theirs = resample(commanded[0].seconds, theirs, measured[0].seconds)
            both = numbers(np.column_stack([own, theirs]))
            at = np.linspace(0, len(both) - 1, POINTS, dtype=np.float64)
            exact = np.ascontiguousarray(both, np.float32)
            moved = np.concatenate([[True], (np.diff(exact, axis=0) != 0).any(axis=1)])
            lineage = signals.lineage or (signals.episode.lineage if signals.episode is not None else "")
            return Motion(signals.name, lineage, signals.split,
                          resample(np.arange(len(both), dtype=np.float64), both, at), sha256(exact.tobytes()),
                          _hashes(exact[moved][:MAX_ROWS]))
    return None


def _hashes(rows: NDArray[np.float32]) -> NDArray[np.uint64]:
    """One number a row, equal for equal rows: a sum of its bits times odd constants, modulo 2^64."""
    odd = np.random.default_rng(1).integers(0, 1 << 62, rows.shape[1], np.uint64) * np.uint64(2) + np.uint64(1)
    bits = rows.view(np.uint32).astype(np.uint64) + np.uint64(1)
    mixed = (bits ^ (bits << np.uint64(29))) * odd
    return (mixed ^ (mixed >> np.uint64(31))).sum(axis=1, dtype=np.uint64)


def duplicates(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """Episodes that hold the same motion: to the bit, nearly so, or in a good part of their rows."""
    motions = [m for s in subject.recordings if (m := motion_of(s, contract)) is not None]
    pairs = same_motion(motions, contract.thresholds)
    for twins in pairs[:SHOWN]:
        yield duplicate(motions[twins.second].name, twins, contract)
    if len(pairs) > SHOWN:
        yield Finding(check="duplicates", what=f"{len(pairs) - SHOWN} more pairs hold the same motion",
                      where=subject.name, value=float(len(pairs)), limit=0.0, mend="leave one of each pair out")


def duplicate(name: str, twins: Twins, contract: Contract) -> Finding:
    """The finding for the later one of two episodes with the same motion."""
    return Finding(check="duplicates", what=twins.what, where=name, value=twins.distance,
                   limit=contract.thresholds.twin_rms, mend=f"leave {name} out: it would count twice")


def leaks(subject: Subject, contract: Contract) -> Iterator[Finding]:
    """What is held out must not be in training in another guise: neither by descent nor by content."""
    told = 0
    owner: dict[str, Signals] = {}
    for signals in subject.recordings:
        first = owner.setdefault(signals.lineage, signals) if signals.lineage else signals
        if first.split != signals.split and told < SHOWN:
            told += 1
            yield Finding(check="leaks", what=f"is in {signals.split}, and {first.name} of the same demonstration in "
                          f"{first.split}", where=signals.name, mend="split by lineage: build the version again, or "
                          "leave one of them out")
    motions = [m for s in subject.recordings if (m := motion_of(s, contract)) is not None]
    across = [t for t in same_motion(motions, contract.thresholds)
              if motions[t.first].split != motions[t.second].split]
    for twins in across[:SHOWN - told]:
        one, other = motions[twins.first], motions[twins.second]
        yield Finding(check="leaks", what=f"is in {other.split} and {twins.what}, which is in {one.split}",
                      where=other.name, value=twins.distance, limit=contract.thresholds.twin_rms,
                      mend="leave one of them out: the validation loss would be too good")


def same_motion(motions: Sequence[Motion], thresholds: Thresholds) -> list[Twins]:
    """Pairs of the same motion, by place. Relatives, such as an attempt and its correction, may share a part of it;
    equal to the bit they may not be."""
    found: dict[tuple[int, int], Twins] = {}
    shapes: dict[int, list[int]] = {}
    for k, motion in enumerate(motions):
        shapes.setdefault(motion.shape.shape[1], []).append(k)
    for members in shapes.values():
        found |= _near(members, motions, thresholds.twin_rms)
        for pair, share in _shared(members, motions).items():
            if share >= thresholds.twin_rows:
                a, b = pair
                what = f"shares {share:.0%} of its rows with {motions[a].name}"
                found.setdefault(pair, Twins(a, b, what, max(1 - share, 1e-12)))
    pairs = [twins for _, twins in sorted(found.items())]
    return [t for t in pairs if t.distance == 0 or not _relatives(motions[t.first], motions[t.second])]


def _relatives(one: Motion, other: Motion) -> bool:
    return bool(one.lineage) and one.lineage == other.lineage


def _near(members: Sequence[int], motions: Sequence[Motion], limit: float) -> dict[tuple[int, int], Twins]:
    """Pairs whose shapes are closer than `limit`, in shares of each column's range over all of them."""
    stack = np.stack([motions[k].shape for k in members])
    flat = stack.reshape(-1, stack.shape[2])
    span = np.ptp(flat, axis=0)
    span = np.maximum(span, STILL * span.max(initial=0.0))  # what hardly moves must not weigh by its noise
    kept = span > 1e-6
    if not kept.any():
        return {}
    shares = ((stack[..., kept] - flat[:, kept].min(axis=0)) / span[kept]).reshape(len(stack), -1)
    squares, width = (shares ** 2).sum(axis=1), shares.shape[1]
    found: dict[tuple[int, int], Twins] = {}
    for start in range(0, len(shares), BLOCK):
        far: Rows = squares[start:start + BLOCK, None] + squares[None] - 2 * shares[start:start + BLOCK] @ shares.T
        for a, b in _places(far < (limit ** 2 + 1e-9) * width, start):
            apart: Rows = shares[a] - shares[b]
            distance = float(np.sqrt(float(apart @ apart) / width))
            if a < b and distance <= limit:
                one = motions[members[a]]
                exact = one.digest == motions[members[b]].digest
                what = f"holds the same motion as {one.name}" if exact else \
                    f"differs from {one.name} by {distance:.2g} of the motion's range only"
                pair = members[a], members[b]
                found[pair] = Twins(*pair, what, 0.0 if exact else max(distance, 1e-12))
    return found


def _places(close: NDArray[np.bool_], start: int) -> Iterator[tuple[int, int]]:
    """Row, counted from `start`, and column of every true value."""
    rows, columns = np.nonzero(close)
    for row, column in zip(rows, columns, strict=True):
        yield start + int(row), int(column)


def _shared(members: Sequence[int], motions: Sequence[Motion]) -> dict[tuple[int, int], float]:
    """Share of the shorter one's rows that both have, for every pair that has some; common poses do not count."""
    sets = {k: np.unique(motions[k].rows) for k in members}
    hashes = np.concatenate(list(sets.values()))
    owners = np.repeat(list(sets), [len(s) for s in sets.values()])
    order = np.lexsort((owners, hashes))
    hashes, owners = hashes[order], owners[order]
    starts = np.flatnonzero(np.concatenate([[True], hashes[1:] != hashes[:-1]]))
    counts = np.diff(np.concatenate([starts, [len(hashes)]]))
    shared: Counter[tuple[int, int]] = Counter()
    for start, count in zip(starts[counts > 1].tolist(), counts[counts > 1].tolist(), strict=True):
        if count <= COMMON:
            shared.update(combinations(owners[start:start + count].tolist(), 2))
    return {(a, b): n / min(len(sets[a]), len(sets[b])) for (a, b), n in shared.items()}
