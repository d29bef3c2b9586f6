"""hardcase measure faces: how small a face the detector of redactions still finds, and what a look costs."""

import json as jsonlib
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.footage import Picture

EDGES = (10, 12, 14, 16, 20, 25, 32)
"""Of the pasted face [px]."""
SIZES = ((96, 128), (240, 320), (480, 640))
"""Height and width of pictures whose looks are timed [px]."""


def run_faces_study(threshold: float, json: Path | None) -> None:
    """Measure and print both tables.

    Raises:
        DatasetError: the detector is not installed or does not work.
    """
    from pipeline.redaction.detector import FIRST, SECOND, centerface
    from pipeline.redaction.recall import recall

    eyes = centerface()
    found = []
    for edge in EDGES:
        print(f"faces of {edge} px", file=sys.stderr)
        found.append(recall(eyes, edge, threshold))
    table = Table("face [px]", "faces", "first look", "one of both", "others", "taken for one", box=None)
    for r in found:
        table.add_row(*(str(v) for v in (r.edge, r.faces, r.first, r.either, r.others, r.mistaken)))
    costs = [[f"{w}x{h}", *(_cost_ms(partial(eyes.faces, look=look, threshold=threshold), h, w)
                            for look in (FIRST, SECOND))] for h, w in SIZES]
    timed = Table("picture", "first look [CPU ms]", "second look [CPU ms]", box=None)
    for name, *ms in costs:
        timed.add_row(str(name), *(f"{one:.0f}" for one in ms))
    console = Console(highlight=False)
    console.print(table, timed)
    if json is not None:
        json.write_text(jsonlib.dumps({"threshold": threshold, "detector": eyes.about, "cost": costs,
                                       "recall": [asdict(r) for r in found]}))


def _cost_ms(look: Callable[[Picture], object], height: int, width: int) -> float:
    """CPU time of one look, the median of three."""
    picture = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    took: list[float] = []
    for _ in range(3):
        start = time.process_time()
        look(picture)
        took.append(1e3 * (time.process_time() - start))
    return sorted(took)[1]
