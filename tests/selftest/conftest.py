"""One whole self-test for all tests of it, its files kept."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from flows.selftest.catching import run_selftest


@pytest.fixture(scope="session")
def tested(tmp_path_factory) -> SimpleNamespace:
    """`hardcase selftest --json OUT --keep FOLDER`: what it printed, its exit code, its JSON, its files."""
    folder = tmp_path_factory.mktemp("selftest")
    text, code = run_selftest(out=folder / "out.json", keep=folder / "files")
    return SimpleNamespace(text=text, code=code, told=json.loads((folder / "out.json").read_text()),
                           clean=folder / "files/clean", planted=folder / "files/planted")


@pytest.fixture(scope="session")
def clean(tested) -> dict[str, list[Path]]:
    """Kind -> clean recordings."""
    return {f.name: sorted(f.glob("*.mcap")) for f in tested.clean.iterdir() if list(f.glob("*.mcap"))}
