"""Places for the boxes of a graph: causes above effects, few crossings, straight ways.

Sources: layers by longest paths, long edges cut into pieces, and order by barycentres after Sugiyama, Tagawa and Toda,
"Methods for visual understanding of hierarchical system structures" (1981); places within a layer by least squares
under a smallest distance, solved by pooling adjacent violators (Barlow et al., 1972).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

SWEEPS = 12
GAP_X, BEND = 22.0, 14.0
"""Space between neighbours, and width that an edge takes on its way through a layer."""

type Edge = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything is, in user units; x is the middle of a box."""

    layers: tuple[tuple[str, ...], ...]
    """Keys by layer from top to bottom, each from left to right; bends of long edges left out."""
    x: Mapping[str, float]
    ways: Mapping[Edge, tuple[float, ...]]
    """Edge -> x in each layer from its first to its last."""
    first: Mapping[str, int]
    """Key -> number of its layer."""
    width: float


def lay_out(keys: Sequence[str], edges: Sequence[Edge], width: float) -> Layout:
    """Place boxes of one width.

    Args:
        keys: the boxes, in an order that breaks ties.
        edges: from cause to effect; an edge that would close a circle is turned round.
        width: of a box.
    """
    straight = _without_circles(keys, edges)
    layer = _layers(keys, straight)
    rows: list[list[str]] = [[] for _ in range(max(layer.values(), default=0) + 1)]
    for key in keys:
        rows[layer[key]].append(key)
    chains: dict[Edge, list[str]] = {}
    for cause, effect in straight:
        bends = [f"\0{cause}\0{effect}\0{k}" for k in range(layer[cause] + 1, layer[effect])]
        for k, bend in enumerate(bends, layer[cause] + 1):
            rows[k].append(bend)
        chains[cause, effect] = [cause, *bends, effect]
    links = [pair for chain in chains.values() for pair in pairwise(chain)]
    up, down = _neighbours(links, 1), _neighbours(links, 0)
    _order(rows, up, down)
    together = {bend: chain[1:-1] for chain in chains.values() for bend in chain[1:-1]}
    x = _places(rows, up, down, {key: width for key in keys}, together)
    left = min((x[k] for k in keys), default=0.0)
    left = min(left, min((x[k] + width / 2 - BEND for k in x), default=left))
    right = max(max((x[k] for k in keys), default=0.0), max((x[k] - width / 2 + BEND for k in x), default=0.0))
    moved = {k: v - left + width / 2 for k, v in x.items()}
    ways: dict[Edge, tuple[float, ...]] = {}
    for cause, effect in edges:
        chain = chains.get((cause, effect)) or chains[effect, cause][::-1]
        ways[cause, effect] = tuple(moved[k] for k in chain)
    shown = tuple(tuple(k for k in row if k in layer) for row in rows)
    return Layout(shown, {k: moved[k] for k in keys}, ways, layer, right - left + width)


def _without_circles(keys: Sequence[str], edges: Sequence[Edge]) -> list[Edge]:
    """The edges, those turned round that lead back to where a walk came from."""
    effects: dict[str, list[str]] = {k: [] for k in keys}
    for cause, effect in edges:
        effects[cause].append(effect)
    state: dict[str, int] = {}
    kept: dict[Edge, None] = {}

    def walk(start: str) -> None:
        stack = [(start, iter(effects[start]))]
        state[start] = 1
        while stack:
            key, rest = stack[-1]
            effect = next(rest, None)
            if effect is None:
                state[key] = 2
                stack.pop()
            elif state.get(effect) == 1:
                kept[effect, key] = None
            else:
                kept[key, effect] = None
                if effect not in state:
                    state[effect] = 1
                    stack.append((effect, iter(effects[effect])))

    has_cause = {effect for _, effect in edges}
    for key in (*(k for k in keys if k not in has_cause), *keys):
        if key not in state:
            walk(key)
    return list(kept)


def _layers(keys: Sequence[str], edges: Sequence[Edge]) -> dict[str, int]:
    """Key -> longest way from a source; what has no cause stands just above its first effect."""
    causes, effects = _neighbours(edges, 1), _neighbours(edges, 0)
    layer: dict[str, int] = {}
    waiting = {k: len(causes.get(k, ())) for k in keys}
    free = [k for k in keys if not waiting[k]]
    while free:
        key = free.pop(0)
        layer[key] = max((layer[c] + 1 for c in causes.get(key, ())), default=0)
        for effect in effects.get(key, ()):
            waiting[effect] -= 1
            if not waiting[effect]:
                free.append(effect)
    for key in keys:
        if not causes.get(key) and effects.get(key):
            layer[key] = min(layer[e] for e in effects[key]) - 1
    return layer


def _neighbours(edges: Sequence[Edge], end: int) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for edge in edges:
        found.setdefault(edge[end], []).append(edge[1 - end])
    return found


def _order(rows: list[list[str]], up: Mapping[str, list[str]], down: Mapping[str, list[str]]) -> None:
    """Sort each row by the middle of its neighbours, down and up in turns; keep the order with the fewest crossings."""
    best, fewest = [list(row) for row in rows], _crossings(rows, down)
    for sweep in range(SWEEPS):
        downwards = sweep % 2 == 0
        for k in range(1, len(rows)) if downwards else range(len(rows) - 2, -1, -1):
            other = {key: i for i, key in enumerate(rows[k - 1 if downwards else k + 1])}
            near = up if downwards else down
            here = {key: i for i, key in enumerate(rows[k])}

            def middle(key: str, other: dict[str, int] = other, here: dict[str, int] = here,
                       near: Mapping[str, list[str]] = near) -> float:
                at = [other[n] for n in near.get(key, ()) if n in other]
                return sum(at) / len(at) if at else here[key]

            rows[k].sort(key=middle)
        if (now := _crossings(rows, down)) < fewest:
            best, fewest = [list(row) for row in rows], now
    rows[:] = best


def _crossings(rows: Sequence[Sequence[str]], down: Mapping[str, list[str]]) -> int:
    count = 0
    for row, below in pairwise(rows):
        at = {key: i for i, key in enumerate(below)}
        ends = [sorted(at[n] for n in down.get(key, ()) if n in at) for key in row]
        for i, one in enumerate(ends):
            count += sum(a > b for other in ends[i + 1:] for a in one for b in other)
    return count


def _places(rows: Sequence[Sequence[str]], up: Mapping[str, list[str]], down: Mapping[str, list[str]],
            wide: Mapping[str, float], together: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """x of everything: each row as near to its neighbours as its order and the distances allow.

    The bends of one edge want to stand below each other; towards its ends they would make it a slope of steps.
    """
    x: dict[str, float] = {}
    for row in rows:
        x |= dict(zip(row, _apart([0.0] * len(row), row, wide), strict=True))
    for sweep in range(4 * SWEEPS):
        for row in rows if sweep % 2 == 0 else reversed(rows):
            wanted: list[float] = []
            for key in row:
                near = together.get(key) or [*up.get(key, ()), *down.get(key, ())]
                wanted.append(sum(x[n] for n in near) / len(near) if near else x[key])
            x |= dict(zip(row, _apart(wanted, row, wide), strict=True))
    return x


def _apart(wanted: Sequence[float], row: Sequence[str], wide: Mapping[str, float]) -> list[float]:
    """The places nearest to the wanted ones, in order and without overlap."""
    offsets = [0.0]
    for a, b in pairwise(row):
        offsets.append(offsets[-1] + (wide.get(a, BEND) + wide.get(b, BEND)) / 2 + GAP_X)
    pools: list[tuple[float, int]] = []
    for want, offset in zip(wanted, offsets, strict=False):
        mean, n = want - offset, 1
        while pools and pools[-1][0] > mean:
            before, m = pools.pop()
            mean, n = (mean * n + before * m) / (n + m), n + m
        pools.append((mean, n))
    flat = [mean for mean, n in pools for _ in range(n)]
    return [place + offset for place, offset in zip(flat, offsets, strict=False)]
