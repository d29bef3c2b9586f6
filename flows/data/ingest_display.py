"""What hardcase ingest says: a table and problems for people, JSON for machines, a bar while it works."""

import json
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from flows.data.ingested import Built, build_version
from flows.data.ingesting import BEGIN, Ingest, Taken
from pipeline.errors import ConfigError, HardcaseError, RecordingError
from pipeline.files import atomic
from pipeline.logs.mapping import load_map
from pipeline.store import Store, store_root
from pipeline.store.folder import check_name
from schemas.conversion import TopicUse
from schemas.recipe import CameraConfig

FINE, REFUSED = 0, 2
PROBLEMS = 8
"""Problems of a log that are shown; all of them are in the JSON."""


@dataclass(frozen=True, slots=True)
class Refused:
    """A file that is no log; nothing of it was stored."""

    path: Path
    error: HardcaseError


type Row = Taken | Refused


def ingest_all(logs: Sequence[Path], map_file: Path, *, dataset: str | None, accept_truncated: bool,
               as_json: bool, sizes: Mapping[str, CameraConfig] | None = None) -> tuple[str, int]:
    """Ingest logs one after the other; a bad one is told, and the others go on.

    Args:
        logs: MCAP files, or folders of them.
        map_file: YAML file with an IngestMap.
        dataset: name of a version to build of them.
        accept_truncated: keep what comes before the first damage.
        as_json: for machines.
        sizes: camera -> size of its videos in the version; the camera's own where it is not named.

    Returns:
        What to print, and the exit code: 0, or 2 where a log was refused or quarantined.

    Raises:
        HardcaseError: the map, the store or the dataset cannot be used, or the only log is bad.
    """
    declared, files, rows, built = load_map(map_file), _files(logs), list[Row](), None
    if dataset is not None:
        check_name("dataset", dataset)
    with Store.open(store_root(), create=True) as store:
        with Ingest(store, declared, accept_truncated=accept_truncated) as work, _bar() as bar:
            for path in files:
                task = bar.add_task(path.name, total=None)
                try:
                    rows.append(work.take(path, lambda done, size, task=task: bar.update(
                        task, completed=done, total=size)))
                except RecordingError as error:
                    rows.append(Refused(path, error))
                bar.remove_task(task)
        if dataset is not None:
            try:
                built = build_version(store, dataset, declared, [r for r in rows if isinstance(r, Taken)], sizes)
            except HardcaseError:
                Console(stderr=True).print(_told(rows, None, store), soft_wrap=True, markup=False)
                raise
        if len(rows) == 1 and (alone := _error(rows[0])) is not None and not as_json:
            raise alone
        code = REFUSED if any(_error(row) is not None for row in rows) else FINE
        return (json.dumps(_as_json(rows, built, store)) if as_json else _told(rows, built, store)), code


def suggest_map(logs: Sequence[Path], out: Path | None) -> str:
    """A first map for a log, as YAML, for printing; with `out` it goes there, and the next step is told.

    Raises:
        RecordingError: the log cannot be read, or has nothing that could become a feature.
        ConfigError: several logs, or `out` is there already.
    """
    from pipeline.logs.suggest import suggest

    if len(logs) != 1 or logs[0].is_dir():
        raise ConfigError("--suggest reads one log", where=" ".join(map(str, logs)),
                          mend="name one recording; its map serves all logs of that robot")
    if out is not None and out.exists():
        raise ConfigError("a file of this name is there already", where=out, mend="name another --out, or remove it")
    text = suggest(logs[0])
    if out is None:
        return text
    with atomic(out) as stream:
        stream.write(text.encode())
    return f"{out} is written: read it, then hardcase ingest {logs[0]} --map {out}\n"


def _files(logs: Sequence[Path]) -> list[Path]:
    """Files as they are named; those in a folder in the order of their names."""
    files = [file for path in logs for file in (sorted(path.rglob("*.mcap")) if path.is_dir() else [path])]
    if not files:
        raise ConfigError("no .mcap file in it", where=", ".join(map(str, logs)), mend=BEGIN)
    return files


def _bar() -> Progress:
    """A bar a log, on a terminal only."""
    return Progress(TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn(),
                    console=Console(stderr=True), transient=True)


def _error(row: Row) -> HardcaseError | None:
    if isinstance(row, Refused):
        return row.error
    made = row.conversion
    if made.state == "converted":
        return None
    quarantined = "" if made.state == "refused" else f"; in quarantine, its bytes are blob {made.log[:12]}"
    return RecordingError(made.reason, where=f"{row.path}{quarantined}", mend=made.mend)


def _told(rows: Sequence[Row], built: Built | None, store: Store) -> str:
    table = Table(box=None, pad_edge=False)
    for name in ("log", "episodes", "frames", "topics used / unused / undecodable", "skew median / max", ""):
        table.add_column(name, overflow="fold", justify="left" if name in ("log", "") else "right")
    for row in rows:
        table.add_row(row.path.name, *_cells(row))
    console = Console(width=140, no_color=True, force_terminal=False)
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    for row in rows:
        lines += [f"{row.path.name}: {line}" for line in _problems(row)]
    if built is not None:
        v = built.version
        lines.append(f"version {v.id}: {_count(v.episodes, "episode")}, {v.frames} frames, {len(v.held_out)} held out: "
                     f"{store.path(v.path)}")
        lines += [f"  left out: {_count(range(n), 'episode')}: {why}" for why, n in built.left_out.items()]
        if built.cameras:
            lines.append(f"  cameras: {', '.join(built.cameras)}")
        lines += [f"  camera {name} waits in the store, not in the version: {why}" for name, why in
                  built.waiting.items()]
    return "\n".join(lines)


def _count(things: Sized, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _cells(row: Row) -> list[str]:
    if isinstance(row, Refused):
        return ["-", "-", "-", "-", "refused"]
    made, result = row.conversion, row.conversion.result
    if result is None:
        return ["-", "-", "-", "-", made.state + (" before" if row.kept else "")]
    uses = [sum(t.use == use for t in result.topics) for use in ("used", "unused", "undecodable")]
    skews = list(result.skews.values())
    worst = [1e3 * max(s.median_s for s in skews), 1e3 * max(s.max_s for s in skews)] if skews else []
    skew = f"{worst[0]:.1f} / {worst[1]:.1f} ms" if worst else "-"
    return [str(len(row.episodes)), str(sum(e.frames for e in row.episodes)), " / ".join(map(str, uses)), skew,
            "kept" if row.kept else ""]


def _problems(row: Row) -> list[str]:
    if isinstance(row, Refused):
        return [row.error.what, f"  mend: {row.error.mend}"]
    made = row.conversion
    if made.result is None:
        return [made.reason, f"  mend: {made.mend}"]
    lines = [*made.result.problems, *(line for use in made.result.topics for line in _about(use))]
    more = [f"and {len(lines) - PROBLEMS} more: hardcase ingest ... --json"] if len(lines) > PROBLEMS else []
    return lines[:PROBLEMS] + more


def _about(use: TopicUse) -> list[str]:
    if use.use == "undecodable":
        return [f"{use.topic}: {use.messages} messages cannot be decoded: {use.reason}"]
    return [f"{use.topic}: {n} messages not used: {reason}" for reason, n in use.left_out.items()]


def _as_json(rows: Sequence[Row], built: Built | None, store: Store) -> dict[str, Any]:
    told: dict[str, Any] = {"logs": [_log_json(row) for row in rows]}
    if built is not None:
        v = built.version
        told["dataset"] = {"version": v.id, "folder": str(store.path(v.path)), "episodes": len(v.episodes),
                           "frames": v.frames, "held_out": len(v.held_out), "left_out": dict(built.left_out),
                           "cameras": list(built.cameras), "cameras_waiting": list(built.waiting)}
    return told


def _log_json(row: Row) -> dict[str, Any]:
    if isinstance(row, Refused):
        return {"log": str(row.path), "state": "refused", "reason": row.error.what, "mend": row.error.mend}
    made = row.conversion
    told: dict[str, Any] = {"log": str(row.path), "sha256": made.log, "state": made.state, "conversion": made.id,
                            "kept": row.kept, "reason": made.reason, "mend": made.mend, "files": made.files,
                            "episodes": [e.id for e in row.episodes], "frames": sum(e.frames for e in row.episodes)}
    return told | (made.result.model_dump(mode="json") if made.result else {})
