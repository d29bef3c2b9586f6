"""Names: what happened in a failure, in words for people."""

from collections.abc import Iterable

from pipeline.mining.happened import Sensed, empty, fell, pushed, subtask

UNLIKE_M, LARGE_M, EMPTY_TICKS, FELL_M, PUSHED_M = 0.05, 0.025, 5, 0.03, 0.04
"""From where on a sign is worth a word: start unlike any taught, height at rest, ticks, fall, push [m]."""


def named(s: Sensed, taken: Iterable[str]) -> str:
    """Name of a family after its medoid: the subtask, then the signs that stood out, then a number if it is taken."""
    signs = [sign for sign, there in (
        ("unlike", s.unlike_m > UNLIKE_M), ("large", s.start[2] > LARGE_M), ("empty", empty(s) > EMPTY_TICKS),
        ("pushed", pushed(s) > PUSHED_M), ("fell", fell(s) > FELL_M)) if there]
    name = "-".join([subtask(s)[0], *signs])
    known = set(taken)
    return next(n for n in (name, *(f"{name}-{k}" for k in range(2, len(known) + 3))) if n not in known)


def told(s: Sensed) -> str:
    """One sentence on what happened."""
    where, tick = subtask(s)
    parts = [f"did not finish '{where}', begun at tick {tick}", f"tool within {100 * s.to_object.min():.1f} cm"]
    if s.held.any():
        parts.append(f"held for {int(s.held.sum())} ticks, lifted {100 * max(0.0, s.height.max()):.1f} cm")
    if empty(s) > EMPTY_TICKS:
        parts.append(f"closed on nothing for {empty(s):.0f} ticks")
    if pushed(s) > PUSHED_M:
        parts.append(f"pushed {100 * pushed(s):.0f} cm before it was held")
    parts.append(f"ended {100 * s.to_mark[-1]:.1f} cm from the mark")
    parts.append(f"object {100 * s.start[2]:.1f} cm high at its centre, {100 * s.unlike_m:.0f} cm from any taught")
    return ", ".join(parts)
