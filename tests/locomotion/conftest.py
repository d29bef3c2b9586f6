"""Bodies of legged robots, and where those of MuJoCo Menagerie lie."""

import os
from pathlib import Path

import pytest

from pipeline.locomotion.biped import biped
from pipeline.locomotion.body import LeggedBody
from pipeline.simulation.register import register

BESIDE = Path(__file__).parents[3] / "shared" / "menagerie"


@pytest.fixture(scope="session", autouse=True)
def _registered() -> None:
    register()


@pytest.fixture(scope="session")
def body() -> LeggedBody:
    return biped()


@pytest.fixture
def menagerie(monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the humanoids that needs no network; skips where there is none."""
    root = Path(os.environ.get("MENAGERIE_ROOT", BESIDE))
    if not (root / "unitree_h1" / "h1.xml").exists():
        pytest.skip(f"no copy of MuJoCo Menagerie in {root}: set MENAGERIE_ROOT")
    monkeypatch.setenv("MENAGERIE_ROOT", str(root))
    return root
