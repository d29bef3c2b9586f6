"""What a machine needs for the loop, looked at one by one, each with its mend."""

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from pipeline.errors import HardcaseError
from pipeline.store import Store, store_root

PACKAGES = ("mujoco", "lerobot", "torch", "prefect", "fastapi", "sqlalchemy", "onnxruntime", "mcap")
"""Packages whose versions were tried together; others may move."""

RENDERERS = {"egl": "libegl1 libgl1", "osmesa": "libosmesa6 libgl1"}
"""Ways to render without a display -> Debian and Ubuntu packages."""

DISK_MB, CORES, MEMORY_MB = 3_000, 2, 3_000
"""What the reference loop needs: its store, its threads, and twice its own peak."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    name: str
    ok: bool
    found: str
    mend: str = ""
    """What to do where it is not ok."""
    needed: bool = True
    """False where everything but one feature goes on without it."""

    def as_dict(self) -> dict[str, Any]:
        """For machines."""
        return asdict(self)


def examine() -> list[Check]:
    """Look at everything; takes about two seconds."""
    with ThreadPoolExecutor() as pool:
        rendering = list(pool.map(_renderer, RENDERERS))
    best = any(check.ok for check in rendering)
    return [_python(), *_versions(), _cores(), _memory(), _disk(), *(_spare(c, best) for c in rendering), *_store()]


def render(checks: list[Check]) -> str:
    """One line a check; the mend below what is not ok."""
    lines: list[str] = []
    for check in checks:
        mark = "ok  " if check.ok else "BAD " if check.needed else "warn"
        lines.append(f"{mark} {check.name:<12} {check.found}")
        if not check.ok:
            lines.append(f"     mend: {check.mend}")
    return "\n".join(lines)


def _python() -> Check:
    found = ".".join(map(str, sys.version_info[:3]))
    return Check("python", sys.version_info[:2] == (3, 12), found, "uv sync --frozen makes an environment with 3.12")


def _versions() -> Iterator[Check]:
    pins = {pin.name.lower(): pin for pin in map(Requirement, _requirements())}
    for name in PACKAGES:
        pin = pins[name]
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Check(name, False, "not installed", "uv sync --frozen")
            continue
        fits = pin.specifier.contains(found, prereleases=True)
        yield Check(name, fits, f"{found} (pinned {pin.specifier})", "uv sync --frozen brings the versions of uv.lock")


def _requirements() -> list[str]:
    """Pins of pyproject.toml, or of the installed package where this runs without a checkout."""
    file = Path(__file__).parents[1] / "pyproject.toml"
    if file.is_file():
        return tomllib.loads(file.read_text(encoding="utf-8"))["project"]["dependencies"]
    return metadata.requires("hardcase") or []


def _cores() -> Check:
    cores = len(os.sched_getaffinity(0))
    mend = "the loop runs, slower; set `threads: 1` in the recipe"
    return Check("cores", cores >= CORES, f"{cores} usable", mend, needed=False)


def _memory() -> Check:
    words = next(line for line in Path("/proc/meminfo").read_text().splitlines() if line.startswith("MemAvailable"))
    free_mb = int(words.split()[1]) * 1024 // 1_000_000
    return Check("memory", free_mb >= MEMORY_MB, f"{free_mb} MB available", "close other programs", needed=False)


def _disk() -> Check:
    root = store_root().absolute()
    existing = next(folder for folder in (root, *root.parents) if folder.exists())
    free_mb = shutil.disk_usage(existing).free // 1_000_000
    mend = "hardcase gc, or a store on another disk: HARDCASE_STORE=/a/local/folder"
    return Check("disk", free_mb >= DISK_MB, f"{free_mb} MB free for {root}", mend)


def _renderer(name: str) -> Check:
    """Whether a process of its own gets a context: a missing library can end the process that asks."""
    code = "import mujoco; c = mujoco.GLContext(64, 64); c.make_current(); c.free()"
    environment = {**os.environ, "MUJOCO_GL": name, "PYOPENGL_PLATFORM": name}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    lines = done.stderr.strip().splitlines() or ["no message"]
    found = "renders without a display" if done.returncode == 0 else lines[-1]
    return Check(name, done.returncode == 0, found, f"sudo apt-get install -y {RENDERERS[name]}")


def _spare(check: Check, other_works: bool) -> Check:
    """One way to render is enough, and only film strips and cameras need any."""
    mend = check.mend + ("" if other_works else "; until then reports have no film strips")
    return Check(check.name, check.ok, check.found, mend, needed=False)


def _store() -> Iterator[Check]:
    root = store_root()
    if not (root / "catalog.db").exists():
        yield Check("store", True, f"none yet at {root}")
        return
    damage = _damage(root)
    if not damage:
        yield Check("store", True, f"every blob and policy of {root} is whole")
    for error in damage:
        yield Check("store", False, f"{error.what}, {error.where}", error.mend)


def _damage(root: Path) -> list[HardcaseError]:
    try:
        with Store.open(root) as store:
            return [*store.verify()]
    except HardcaseError as error:
        return [error]
