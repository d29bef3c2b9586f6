"""The reference loop from process start to the printed table: wall time and peak memory, median of three.

Run it on an idle machine: python -m pytest -s -p no:xdist --timeout 1800 tests/bench_demo.py
Each run has a store and a PREFECT_HOME of its own, so nothing is resumed and Prefect's database is fresh.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUNS = 3
LIMIT_S, LIMIT_MB = 180, 1500
"""Asked of the reference loop on two cores."""


def test_the_reference_loop(tmp_path):
    walls, peaks = [], []
    for number in range(RUNS):
        store, result = tmp_path / f"store-{number}", tmp_path / f"{number}.json"
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "HARDCASE"))}
        environment = {**clean, "HARDCASE_STORE": str(store), "PYTHONPATH": str(ROOT)}
        began = time.monotonic()
        subprocess.run([sys.executable, "-m", "flows.cli", "loop", "--json", str(result)], cwd=ROOT, env=environment,
                       check=True, capture_output=True)
        walls.append(time.monotonic() - began)
        told = json.loads(result.read_text())
        peaks.append(told["peak_pss_mb"])
        first, last = (told["generations"][g]["success"]["deployment_mix"]["rate"] for g in (0, -1))
        print(f"\nrun {number}: {walls[-1]:.1f} s wall, {peaks[-1]:.0f} MB, deployment mix {first:.3f} -> {last:.3f}")
    print(f"median of {RUNS}: {statistics.median(walls):.1f} s wall (asked: {LIMIT_S}), "
          f"{statistics.median(peaks):.0f} MB summed PSS (asked: {LIMIT_MB})")
    assert statistics.median(walls) < LIMIT_S
    assert max(peaks) < LIMIT_MB
