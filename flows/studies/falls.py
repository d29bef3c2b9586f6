"""`hardcase measure legged`: does a legged robot fall less from lap to lap, and less than without hard starts?"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.table import Table

from flows.run.arms import LOOP
from flows.studies.measured import write_json
from flows.studies.study import study_seed
from pipeline.locomotion.tasks import load_legged_task
from pipeline.recipes import load_recipe
from pipeline.statistics import bootstrap_difference, sign_test
from pipeline.store import store_root
from schemas.recipe import Recipe

CONTROL = "random"
"""The arm that trains as many steps at drawn starts."""
SHOWN = ("champion", "candidate")
"""What the gate let through, and what was trained last whether or not it was let through."""

type Bits = NDArray[np.bool_]


def run_falls_study(*, seeds: int, recipe: str, json: Path | None) -> dict[str, Any]:
    """Turn the loop and its control for every seed, print fall rates on the twins, and hand back everything.

    A seed that is finished is not done again; one that was cut off goes on where it was.

    Args:
        seeds: how many; seed k has twin 100 + k.
        recipe: name or path of a recipe with `rl`.
        json: where to write all of it.
    """
    loaded, console = load_recipe(recipe), Console(stderr=True)
    folder = store_root() / "study" / Path(recipe).stem
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    found: list[dict[str, Any]] = []
    for seed in range(seeds):
        found.append(study_seed(seed, loaded, folder, (LOOP, CONTROL)))
        console.print(f"seed {seed} finished, {len(found)} of {seeds}")
    pooled = pool(found, loaded)
    Console(width=150).print(tables(found, pooled, loaded))
    everything = {"recipe": loaded.name, "seeds": found, "pooled": pooled}
    write_json(json, everything)
    return everything


def pool(seeds: Sequence[dict[str, Any]], recipe: Recipe) -> dict[str, Any]:
    """Fall rates by lap, what the laps took off them, and how far the loop is ahead of its control, lap by lap."""
    mix, rare = shares_of(recipe)
    laps = range(len(seeds[0]["arms"][LOOP]["laps"]))
    found: dict[str, Any] = {}
    for who in SHOWN:
        found[who] = {
            "falls": {name or "loop": [[_falls(s, name, g, who, mix) for s in seeds] for g in laps]
                      for name in (LOOP, CONTROL)},
            "falls_rare": {name or "loop": [[_falls(s, name, g, who, rare) for s in seeds] for g in laps]
                           for name in (LOOP, CONTROL)},
            "since_0": {name or "loop": [_apart(seeds, (name, g), (name, 0), who, mix) for g in laps]
                        for name in (LOOP, CONTROL)},
            "fewer_than_control": [_apart(seeds, (LOOP, g), (CONTROL, g), who, mix) for g in laps],
            "fewer_than_control_rare": [_apart(seeds, (LOOP, g), (CONTROL, g), who, rare) for g in laps]}
        ahead = [b - a for a, b in zip(found[who]["falls"]["loop"][-1], found[who]["falls"][CONTROL][-1], strict=True)]
        sign = sign_test(ahead)
        found[who]["seeds_won"] = [sign.wins, sign.wins + sign.losses]
    return found


def shares_of(recipe: Recipe) -> tuple[dict[str, float], dict[str, float]]:
    """Kind of start -> its share at work, and among the rare starts alone."""
    task, share = load_legged_task(recipe.task), recipe.deploy.rare_share
    rare = {name: s / sum(task.rare.values()) for name, s in task.rare.items()}
    mix = {name: (1 - share) / len(task.common) for name in task.common}
    return mix | {name: share * s for name, s in rare.items()}, rare


def _bits(seed: dict[str, Any], arm: str, lap: int, who: str, kind: str) -> Bits:
    strata = np.array(seed["arms"][LOOP]["laps"][0]["strata"])
    return np.array([b == "1" for b in seed["arms"][arm]["laps"][lap][who]])[strata == kind]


def _falls(seed: dict[str, Any], arm: str, lap: int, who: str, shares: dict[str, float]) -> float:
    return 1 - sum(w * float(_bits(seed, arm, lap, who, kind).mean()) for kind, w in shares.items())


def _apart(seeds: Sequence[dict[str, Any]], one: tuple[str, int], other: tuple[str, int], who: str,
           shares: dict[str, float]) -> dict[str, float]:
    """How many fewer attempts end in a fall under the first of two policies, on the same starts; seeds, then scenes."""
    strata = {kind: (np.stack([_bits(s, *one, who, kind) for s in seeds]),
                     np.stack([_bits(s, *other, who, kind) for s in seeds])) for kind in shares}
    found = bootstrap_difference(strata, shares, np.random.default_rng(0))
    return {"estimate": found.estimate, "low": found.low, "high": found.high}


def tables(seeds: Sequence[dict[str, Any]], pooled: dict[str, Any], recipe: Recipe) -> Group:
    """The study for people: a table for champions and one for candidates."""
    made: list[Any] = []
    for who in SHOWN:
        p = pooled[who]
        shown = Table("generation", "loop falls", "rare starts", "control falls", "rare starts", "fewer than control",
                      "on rare starts", "fewer than generation 0",
                      title=f"{recipe.name}: falls on the twin, {who}s, mean of {len(seeds)} seeds, 95 % intervals")
        for g, ahead in enumerate(p["fewer_than_control"]):
            shown.add_row(str(g), *(f"{np.mean(p[key][arm][g]):.3f}" for arm in ("loop", CONTROL)
                                    for key in ("falls", "falls_rare")),
                          _interval(ahead), _interval(p["fewer_than_control_rare"][g]),
                          _interval(p["since_0"]["loop"][g]) if g else "")
        made += [shown, f"fewer falls than the control after the last lap in {p['seeds_won'][0]} of "
                 f"{p['seeds_won'][1]} seeds"]
    gates = [", ".join(lap["decision"] for lap in s["arms"][name]["laps"]) for s in seeds for name in (LOOP, CONTROL)]
    return Group(*made, "gates: " + "; ".join(gates))


def _interval(found: dict[str, float]) -> str:
    return f"{found['estimate']:+.3f} [{found['low']:+.3f} {found['high']:+.3f}]"
