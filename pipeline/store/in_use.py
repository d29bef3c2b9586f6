"""Which processes have a file open below a folder, as far as the system tells."""

import os
from pathlib import Path

from pipeline.store.process import PROC


def writers(folder: Path) -> list[str]:
    """Other processes with an open file below a folder, as 'pid 12 (command)'; empty where there is no /proc."""
    root = f"{folder.resolve()}/"
    return [told for process in _processes() if any(name.startswith(root) for name in _open(process))
            for told in (_tell(process),)]


def _processes() -> list[Path]:
    if not PROC.is_dir():
        return []
    return sorted((p for p in PROC.iterdir() if p.name.isdigit() and p.name != str(os.getpid())),
                  key=lambda p: int(p.name))


def _open(process: Path) -> list[str]:
    try:
        handles = list((process / "fd").iterdir())
    except OSError:  # it has ended, or belongs to another user
        return []
    names: list[str] = []
    for handle in handles:
        try:
            names.append(str(handle.readlink()))
        except OSError:
            continue
    return names


def _tell(process: Path) -> str:
    try:
        words = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        words = ""
    return f"pid {process.name} ({words[:80] or 'unknown'})"
