"""Cleaning up: gc, recover."""

import json
from pathlib import Path

from pipeline.errors import RecordingError
from pipeline.store import Store, store_root


def sweep(*, delete: bool, as_json: bool) -> str:
    """What nothing refers to any more; removed only if asked.

    Raises:
        StoreError: no store, a loop is running on it, or something cannot be removed.
    """
    from pipeline.store.caches import cache_folder
    from pipeline.store.gc import collect, unreferenced

    with Store.open(store_root()) as store:
        garbage = unreferenced(store, caches=[cache_folder()])
        freed = collect(store, garbage) if delete else 0
    pieces = [{"path": str(p.path), "kind": p.kind, "bytes": p.bytes} for p in garbage.pieces]
    if as_json:
        return json.dumps({"pieces": pieces, "bytes": garbage.bytes, "freed": freed, "young": garbage.young})
    lines = [f"{p.bytes / 1e6:10.1f} MB  {p.kind:<10} {p.path}" for p in garbage.pieces]
    lines.append(f"{len(pieces)} things, {garbage.bytes / 1e6:.1f} MB; {garbage.young} more are too young to judge")
    if delete:
        lines.append(f"removed, {freed / 1e6:.1f} MB given back")
    elif pieces:
        lines.append("nothing was touched; to remove them: hardcase gc --delete")
    return "\n".join(lines)


def recover_recordings(folder: Path | None, *, as_json: bool) -> str:
    """Deal with every recording below a folder that a killed writer left; the store's by default.

    Raises:
        RecordingError: no such folder, or the disk refuses.
    """
    from pipeline.logs.child import Children
    from pipeline.logs.inspection import inspect
    from pipeline.recording.recover import recover

    root = folder or store_root()
    if not root.is_dir():
        raise RecordingError("no such folder", where=root, mend="name the folder that holds NAME.mcap.part")
    with Children() as children:  # the folder may come from anywhere
        done = recover(root, gate=lambda part: inspect(part, accept_truncated=True, children=children))
    if as_json:
        facts = [
            {"part": str(r.part), "kept": str(r.kept) if r.kept else None, "frames": r.frames, "reason": r.reason}
            for r in done
        ]
        return json.dumps(facts)
    lines = [f"{r.part}: " + (f"{r.frames} frames kept as {r.kept}" if r.kept else "quarantined") for r in done]
    reasons = [f"  {r.reason}" if r.reason else "" for r in done]
    told = [text for pair in zip(lines, reasons, strict=True) for text in pair if text]
    return "\n".join(told) or f"no cut-off recordings below {root}"
