"""Pooling: what a study says over all seeds; seeds are drawn first, then scenes."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table

from pipeline.simulation.tasks import load_task
from pipeline.statistics import bootstrap_difference, predict_quality, sign_test
from schemas.recipe import Recipe

type Bits = NDArray[np.bool_]
type Seed = dict[str, Any]

CLEAR = 0.02
"""Difference of two policies, at the gate and at the exam, from which its sign is counted."""

SHOWN = ("champion", "candidate")
"""What the gate let through, and what was trained last whether or not it was let through."""


def pool(seeds: Sequence[Seed], recipe: Recipe) -> dict[str, Any]:
    """Success of every arm, its difference to the loop, gain of the loop over its laps, and how the gate foretold."""
    shares = _shares(recipe, seeds[0])
    return {
        "arms": {name: _arm(seeds, name, shares) for name in seeds[0]["arms"]},
        "generations": [_generation(seeds, g, shares) for g in range(len(seeds[0]["arms"][""]["laps"]))],
        "prediction": _prediction(seeds),
        "decisions": _decisions(seeds),
    }


def _shares(recipe: Recipe, seed: Seed) -> dict[str, float]:
    task, share = load_task(recipe.task), recipe.deploy.rare_share
    shares = {n: (1 - share) / len(task.common) for n in task.common}
    shares |= {n: share * s / sum(task.rare.values()) for n, s in task.rare.items() if share > 0}
    return {n: s for n, s in shares.items() if n in seed["arms"][""]["laps"][0]["strata"]}


def _bits(seed: Seed, arm: str, lap: int, who: str) -> Bits:
    return np.array([b == "1" for b in seed["arms"][arm]["laps"][lap][who]])


def _strata(seed: Seed) -> NDArray[np.str_]:
    return np.array(seed["arms"][""]["laps"][0]["strata"])


def _mix(seeds: Sequence[Seed], arm: str, lap: int, who: str, shares: dict[str, float]) -> list[float]:
    return [sum(w * float(_bits(s, arm, lap, who)[_strata(s) == n].mean()) for n, w in shares.items()) for s in seeds]


def _rare(seeds: Sequence[Seed], arm: str, lap: int, who: str) -> list[float]:
    picked = [_bits(s, arm, lap, who)[_strata(s) != "common"] for s in seeds]
    return [float(p.mean()) if p.size else float("nan") for p in picked]


def _arm(seeds: Sequence[Seed], name: str, shares: dict[str, float]) -> dict[str, Any]:
    last, laps = len(seeds[0]["arms"][""]["laps"]) - 1, len(seeds[0]["arms"][name]["laps"]) - 1
    found: dict[str, Any] = {"says": seeds[0]["arms"][name]["says"], "generation": laps}
    for who in SHOWN:
        mix = _mix(seeds, name, laps, who, shares)
        entry: dict[str, Any] = {"mix": mix, "rare": _rare(seeds, name, laps, who)}
        if name:
            loop = _mix(seeds, "", last, who, shares)
            entry["loop_ahead"] = _ahead(seeds, name, (last, laps), who, shares)
            entry["sign"] = _plain(sign_test([a - b for a, b in zip(loop, mix, strict=True)]))
            if all(np.isfinite(entry["rare"])):
                rare = {n: w / sum(w for m, w in shares.items() if m != "common")
                        for n, w in shares.items() if n != "common"}
                entry["loop_ahead_rare"] = _ahead(seeds, name, (last, laps), who, rare) if rare else None
        found[who] = entry
    found["asked"] = [sum(lap["asked"] or 0 for lap in s["arms"][name]["laps"]) for s in seeds]
    found["robot_s"] = [sum(lap["robot_s"] for lap in s["arms"][name]["laps"]) for s in seeds]
    return found


def _ahead(seeds: Sequence[Seed], name: str, laps: tuple[int, int], who: str, shares: dict[str, float]) -> Any:
    strata = {n: (np.stack([_bits(s, "", laps[0], who)[_strata(s) == n] for s in seeds]),
                  np.stack([_bits(s, name, laps[1], who)[_strata(s) == n] for s in seeds])) for n in shares}
    return _plain(bootstrap_difference(strata, shares, np.random.default_rng(0)))


def _generation(seeds: Sequence[Seed], g: int, shares: dict[str, float]) -> dict[str, Any]:
    return {who: {"mix": _mix(seeds, "", g, who, shares), "rare": _rare(seeds, "", g, who),
                  "common": [float(_bits(s, "", g, who)[_strata(s) == "common"].mean()) for s in seeds]}
            for who in SHOWN}


def _prediction(seeds: Sequence[Seed]) -> dict[str, Any]:
    """Candidate minus champion at the gate against the same at the exam, over every gated pair of every arm."""
    told: list[float] = []
    was: list[float] = []
    for seed in seeds:
        for arm in seed["arms"]:
            laps = seed["arms"][arm]["laps"]
            for before, lap in pairwise(laps):
                everything = lap["gate"][0]
                if everything["champion"] is None:
                    continue
                told.append(everything["candidate"]["rate"] - everything["champion"]["rate"])
                was.append((lap["candidate"].count("1") - before["champion"].count("1")) / len(lap["candidate"]))
    if not told:
        return {}
    clear = [a * b > 0 for a, b in zip(told, was, strict=True) if min(abs(a), abs(b)) > CLEAR]
    return {**_plain(predict_quality(told, was)), "pairs": len(told), "clear": len(clear),
            "clear_with_the_same_sign": sum(clear) / len(clear) if clear else None}


def _decisions(seeds: Sequence[Seed]) -> dict[str, int]:
    counted: dict[str, int] = {}
    for seed in seeds:
        for lap in seed["arms"][""]["laps"]:
            key = f"generation {lap['generation']}: {lap['decision']}"
            counted[key] = counted.get(key, 0) + 1
    return dict(sorted(counted.items()))


def _plain(value: Any) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__dataclass_fields__}


def tables(pooled: dict[str, Any]) -> Group:
    """The pooled numbers as tables for a terminal."""
    arms = Table("arm", "mix", "rare", "loop ahead at the mix", "loop ahead on rare", "seeds won", "by a person",
                 "robot s",
                 title="Last candidate of each arm, mean over seeds; bootstrap over seeds, then scenes")
    for name, arm in pooled["arms"].items():
        entry = arm["candidate"]
        sign = entry.get("sign")
        arms.add_row(name or "loop", f"{np.mean(entry['mix']):.3f}", f"{np.mean(entry['rare']):.3f}",
                     _interval(entry.get("loop_ahead")), _interval(entry.get("loop_ahead_rare")),
                     f"{sign['wins']} of {sign['wins'] + sign['losses']}" if sign else "",
                     f"{np.mean(arm['asked']):.0f}", f"{np.mean(arm['robot_s']):.0f}")
    laps = Table("generation", "mix, median", "rare, median", "common, median", title="The loop's champion")
    for g, lap in enumerate(pooled["generations"]):
        entry = lap["champion"]
        laps.add_row(str(g), *(f"{np.median(entry[k]):.3f}" for k in ("mix", "rare", "common")))
    return Group(arms, laps, f"gate against exam: {pooled['prediction']}", f"decisions: {pooled['decisions']}")


def _interval(value: dict[str, float] | None) -> str:
    return f"{value['estimate']:+.3f} [{value['low']:+.3f} {value['high']:+.3f}]" if value else ""
