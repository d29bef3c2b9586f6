"""hardcase diff: what differs between two versions, and why, as far as their manifests tell."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flows.data.deriving import named_version
from pipeline.lerobot_view.difference import Difference, difference
from pipeline.lerobot_view.opened import Opened, open_version
from pipeline.store import Store, store_root
from schemas.dataset import DatasetVersion
from schemas.edits import line

SHOWN = 20


def compare(first: str, second: str, root: Path | None = None) -> dict[str, Any]:
    """Two versions by their ids: what differs, from the first to the second, and why.

    Raises:
        StoreError: there is no such version.
        DatasetError: a folder is damaged.
    """
    with Store.open(root or store_root()) as store:
        one, two = (named_version(store, name, f"{which} VERSION {name}") for which, name in (("first", first),
                                                                                             ("second", second)))
        a, b = (open_version(store.path(v.path), v) for v in (one, two))
        found = difference(a, b)
        return {
            "first": one.id, "second": two.id, "why": _why(store, one, two, a, b),
            "episodes": {"first": len(one.episodes), "second": len(two.episodes), "removed": list(found.removed),
                         "added": list(found.added), "moved": found.moved, "changed": _plain(found)},
            "frames": {"first": one.frames, "second": two.frames},
            "weights": {"first": one.weights, "second": two.weights},
            "features": {name: list(pair) for name, pair in found.features.items()},
            "statistics": {name: dict(measures) for name, measures in found.statistics.items()},
            "same": found.nothing and one.weights == two.weights}


def _plain(found: Difference) -> dict[str, dict[str, list[object]]]:
    return {id: {what: list(pair) for what, pair in of.items()} for id, of in found.changed.items()}


def _why(store: Store, one: DatasetVersion, two: DatasetVersion, a: Opened, b: Opened) -> list[str]:
    """Edits and builds between the two, one line each, from the version that both come from."""
    up, down = _chain(store, one), _chain(store, two)
    common = next((v for v in up if v in down), None)
    lines: list[str] = []
    for side, chain in (("first", up), ("second", down)):
        steps = list(chain.values())[:list(chain).index(common) if common else len(chain)]
        for version in reversed(steps):
            lines += [f"{version.id} ({side}): {text}" for text in (
                [line(e) for e in version.edits] or [f"built by recipe {version.recipe}, generation "
                                                     f"{version.generation}"])]
    for key in ("recipe", "task"):
        if a.manifest.get(key) != b.manifest.get(key):
            lines.append(f"the manifests differ in {key}")
    if one.code != two.code and not (one.edits or two.edits):
        lines.append("other code made them")
    for version in (one, two):
        if version.erased:
            lines.append(f"{version.id} is incomplete: erased ({len(version.erased)} episodes)")
    return lines


def _chain(store: Store, version: DatasetVersion) -> dict[str, DatasetVersion]:
    """The version and its parents, itself first."""
    chain = {version.id: version}
    while version.parent is not None and version.parent not in chain:
        version = store.version(version.parent)
        chain[version.id] = version
    return chain


def render(told: Mapping[str, Any]) -> str:
    """The summary first, then reasons, episodes, statistics."""
    episodes, frames = told["episodes"], told["frames"]
    if told["same"]:
        return f"{told['first']} and {told['second']} hold the same"
    counts = Counter(what for of in episodes["changed"].values() for what in of)
    summary = [f"{len(episodes['removed'])} episodes less", f"{len(episodes['added'])} more",
               *(f"{n} with another {what}" for what, n in counts.most_common())]
    lines = [f"{told['first']} -> {told['second']}: {episodes['first']} -> {episodes['second']} episodes, "
             f"{frames['first']} -> {frames['second']} frames", "  " + ", ".join(summary)]
    if told["weights"]["first"] != told["weights"]["second"]:
        lines.append(f"  shares: {_shares(told['weights']['first'])} -> {_shares(told['weights']['second'])}")
    lines += ["why"] + [f"  {text}" for text in told["why"]] if told["why"] else []
    listed = [f"- {id}" for id in episodes["removed"]] + [f"+ {id}" for id in episodes["added"]]
    listed += [f"~ {id}  {_changes(of)}" for id, of in episodes["changed"].items() if set(of) - {"weight"}]
    if listed:
        lines += ["episodes", *(f"  {text}" for text in listed[:SHOWN])]
        lines += [f"  and {len(listed) - SHOWN} more: --json lists all"] * (len(listed) > SHOWN)
    for name, (first, second) in told["features"].items():
        lines.append(f"feature {name}: {'only in the second' if first is None else 'only in the first'}"
                     if first is None or second is None else f"feature {name} is declared otherwise")
    if told["statistics"]:
        lines.append("statistics, largest difference of a value")
        for name, measures in told["statistics"].items():
            lines.append(f"  {name}: " + ", ".join(f"{m} {value:.3g}" for m, value in measures.items()))
    return "\n".join(lines)


def _shares(weights: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {share:.3f}" for name, share in weights.items())


def _changes(of: Mapping[str, list[object]]) -> str:
    told: list[str] = []
    for what, (first, second) in of.items():
        if what == "rows":
            told.append(f"values of {first}")
        elif what == "pictures":
            told.append(f"pictures of {first}")
        elif what == "segments":
            told.append("segments")
        elif isinstance(first, float) and isinstance(second, float):
            told.append(f"{what} {first:.4g} -> {second:.4g}")
        else:
            told.append(f"{what} {first} -> {second}")
    return ", ".join(told)
