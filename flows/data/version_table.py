"""hardcase datasets: the versions of the store, or the episodes of one; hardcase episodes: those of the catalog."""

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.data.deriving import named_version
from pipeline.arrow import read_parquet
from pipeline.lerobot_view.incomplete import CURRICULUM
from pipeline.lerobot_view.layout import EPISODES, INFO
from pipeline.lerobot_view.opened import FIELDS, open_version
from pipeline.query import Fields, parse
from pipeline.redaction.statement import STATEMENT
from pipeline.store import Store, store_root
from schemas.dataset import DatasetVersion
from schemas.edits import Add, line

MB = 1e6
CATALOG: Mapping[str, str] = {
    "id": "id", "source": "origin", "outcome": "label", "stratum": "stratum", "parent": "parent", "policy": "policy",
    "generation": "generation", "frames": "json_extract(json, '$.frames')",
    "family": "json_extract(json, '$.outcome.family')", "trigger": "json_extract(json, '$.outcome.trigger')",
    "task": "json_extract(json, '$.scene.task')", "robot": "json_extract(json, '$.scene.robot')",
    "consent": "json_extract(json, '$.consent')"}
"""What a query may ask of the episodes of the store, and where the catalog keeps it."""

CATALOG_FIELDS: Fields = {name: "number" if name in ("generation", "frames") else "text" for name in CATALOG}


def versions(root: Path | None = None) -> list[dict[str, Any]]:
    """What there is to know of each version, in the order of adding.

    `own_bytes` is what removing it alone would free; `shared_bytes` is of files that other versions hold as well.
    """
    with Store.open(root or store_root()) as store:
        every = store.versions()
        files = {v.id: _files(store.path(v.path)) for v in every}
        holders = Counter(inode for found in files.values() for inode in found)
        return [_told(store, v, files[v.id], holders) for v in every]


def _told(store: Store, version: DatasetVersion, files: Mapping[int, int],
          holders: Mapping[int, int]) -> dict[str, Any]:
    folder = store.path(version.path)
    own = sum(size for inode, size in files.items() if holders[inode] == 1)
    told: dict[str, Any] = {
        "id": version.id, "recipe": version.recipe, "generation": version.generation, "folder": str(folder),
        "episodes": len(version.episodes), "frames": version.frames, "held_out": len(version.held_out),
        "own_bytes": own, "shared_bytes": sum(files.values()) - own, "parents": _parents(version),
        "edits": [line(e) for e in version.edits], "redacted": (folder / STATEMENT).is_file(),
        "erased": len(version.erased), "weights": version.weights}
    if (folder / CURRICULUM).is_file():
        kinds = Counter("held out for the gate" if e in version.held_out else "that teach" for e in version.episodes)
        starts = {f"starts of falls {kind}": n for kind, n in kinds.items()} or {"curriculum of drawn starts": 1}
        return {**told, "sources": starts, "success": None, "cameras": [], "missing": False}
    if not (folder / EPISODES).is_file():
        return {**told, "sources": {}, "success": None, "cameras": [], "missing": True}
    table = read_parquet(folder / EPISODES, ["source", "outcome"])
    labels = Counter[str](table.column("outcome").to_pylist())
    features: dict[str, Any] = json.loads((folder / INFO).read_text(encoding="utf-8"))["features"]
    judged = labels["success"] + labels["failure"]
    return {**told, "sources": dict(Counter[str](table.column("source").to_pylist()).most_common()),
            "success": labels["success"] / judged if judged else None,
            "cameras": [n for n, f in features.items() if f["dtype"] == "video"], "missing": False}


def _parents(version: DatasetVersion) -> list[str]:
    added = [e.version for e in version.edits if isinstance(e, Add)]
    return list(dict.fromkeys([*([version.parent] if version.parent else []), *added]))


def _files(folder: Path) -> dict[int, int]:
    """Inode -> size of every file below a folder."""
    found: dict[int, int] = {}
    for at, _, names in os.walk(folder):
        for name in names:
            stat = os.lstat(os.path.join(at, name))  # noqa: PTH118
            found[stat.st_ino] = stat.st_size
    return found


def render(rows: Sequence[Mapping[str, Any]]) -> str:
    """Versions as a table, the newest last."""
    if not rows:
        return "no dataset versions yet: hardcase loop, hardcase ingest --dataset NAME, hardcase import FOLDER"
    table = Table(box=None, pad_edge=False)
    for name, side in (("version", "left"), ("from", "left"), ("episodes", "right"), ("frames", "right"),
                       ("success", "right"), ("own MB", "right"), ("shared MB", "right"), ("cameras", "left"),
                       ("sources", "left")):
        table.add_column(name, justify=side, no_wrap=name != "sources")  # type: ignore[arg-type]
    for row in rows:
        cameras = ", ".join(c.rpartition(".")[2] for c in row["cameras"]) or "none"
        sources = ", ".join(f"{n} {source}" for source, n in row["sources"].items())
        if row["missing"]:
            sources = "its folder is missing"
        elif row["erased"]:
            sources += f"; incomplete: erased ({row['erased']} episodes)"
        sources += "; redacted, signed" * row["redacted"]
        table.add_row(row["id"], ", ".join(p[:8] for p in row["parents"]) or row["recipe"], str(row["episodes"]),
                      str(row["frames"]), "-" if row["success"] is None else f"{row['success']:.3f}",
                      f"{row['own_bytes'] / MB:.2f}", f"{row['shared_bytes'] / MB:.2f}", cameras, sources)
    return _printed(table)


def episodes_of(name: str, where: str | None, root: Path | None = None) -> list[dict[str, Any]]:
    """The episodes of one version that a query chooses; every field that queries know."""
    with Store.open(root or store_root()) as store:
        version = named_version(store, name, f"VERSION {name}")
        opened = open_version(store.path(version.path), version)
    columns = {field: opened.asked(field).tolist() for field in FIELDS}
    mask = parse(where, FIELDS).mask(opened.asked).tolist() if where else [True] * len(opened)
    return [{f: values[k] for f, values in columns.items()} for k, chosen in enumerate(mask) if chosen]


def catalog_episodes(where: str | None, root: Path | None = None) -> list[dict[str, Any]]:
    """The episodes of the whole store that a query chooses, in the order of adding."""
    test, values = parse(where, CATALOG_FIELDS).sql(CATALOG) if where else ("true", ())
    with Store.open(root or store_root()) as store:
        rows = store.query(f"SELECT {', '.join(CATALOG.values())} FROM episode WHERE {test} ORDER BY place", values)
    return [dict(zip(CATALOG, row, strict=True)) for row in rows]


def render_episodes(rows: Sequence[Mapping[str, Any]], limit: int) -> str:
    """Episodes as a table, then how many there are of each source and outcome."""
    fields = [f for f in ("id", "source", "outcome", "family", "stratum", "generation", "frames", "split", "group",
                          "weight") if rows and f in rows[0]]
    table = Table(*fields, box=None, pad_edge=False)
    for row in rows[:limit]:
        table.add_row(*(_cell(row[f]) for f in fields))
    counts = Counter((str(r["source"]), str(r["outcome"])) for r in rows)
    told = ", ".join(f"{n} {source} {outcome}" for (source, outcome), n in counts.most_common())
    more = f" ({len(rows) - limit} not shown; --limit {len(rows)} shows all)" if len(rows) > limit else ""
    return "\n".join([*([_printed(table)] if rows else []), f"{len(rows)} episodes: {told or 'none'}{more}"])


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return "-" if value is None else str(value)


def _printed(table: Table) -> str:
    console = Console(width=None if Console().is_terminal else 200, highlight=False)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(text.rstrip() for text in captured.get().splitlines())
