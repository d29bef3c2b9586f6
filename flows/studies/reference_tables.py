"""The tables of `hardcase measure reference`."""

from typing import Any

import numpy as np
from rich.table import Table

SAID = {"ours": "ours, one Batch", "dummy": "SB3's DummyVecEnv"}


def tables(found: dict[str, Any]) -> list[Table]:
    """Every training, and all of them pooled beside the published figures."""
    single = Table("task", "vector environment", "seed", "mean return", "sd", "length", "CPU s", "steps/CPU s",
                   "weights", title=f"{found['steps']:,} steps; {found['episodes']} deterministic episodes each")
    for run in found["runs"]:
        returns = np.array(run["returns"])
        single.add_row(run["task"], SAID[run["arm"]], str(run["seed"]), f"{returns.mean():.0f}", f"{returns.std():.0f}",
                       f"{np.mean(run['lengths']):.0f}", f"{run['cpu_s']:.0f}",
                       f"{run['steps'] / run['cpu_s']:.0f}", run["weights"][:8])
    whole = Table("task", "vector environment", "seeds", "interquartile mean", "mean", "published", "share",
                  "equal weights", title="over seeds and episodes, 95 % intervals")
    for task, told in found["pooled"].items():
        for arm, one in told["arms"].items():
            whole.add_row(task, SAID[arm], str(len(one["seeds"])),
                          f"{one['iqm']:.0f} [{one['low']:.0f} {one['high']:.0f}]", f"{one['mean']:.0f}",
                          f"{found['published'][task]:.0f}", f"{one['share']:.2f}",
                          f"{len(told['equal'])} of {len(told['both'])} seeds")
    return [single, whole]
