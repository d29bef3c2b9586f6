"""`hardcase measure nights`: years of nights by the thousand, and the power of one beside STEP and a fixed design."""

from collections.abc import Iterable
from math import sqrt
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from flows.studies.measured import write_json
from pipeline.files import atomic
from pipeline.recipes import load_recipe

EFFECTS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10)
"""Gains that are drawn; those of SHOWN are in the table."""
SHOWN = (0.02, 0.05, 0.10)
STEP_SCENES, STEP_EVERY = 500, 10
"""Largest number of scenes that the authors of STEP have tried, and scenes between our decisions in that comparison."""


def run_nights_study(*, years: int, nights: int, recipe: str, json: Path | None, svg: Path | None) -> dict[str, Any]:
    """Live the years, measure the power, print both, and write them where asked.

    Args:
        years: simulated years of each world.
        nights: played nights of each effect.
        recipe: name or path of a recipe with a nightly gate.
        json: where to write everything.
        svg: folder for the two charts.
    """
    found = {"years": lived(years, recipe), "power": measured_power(nights, recipe)}
    for table in tables(found):
        Console().print(table)
    write_json(json, found)
    if svg is not None:
        for name, text in charts(found["power"]).items():
            with atomic(svg / f"{name}.svg") as stream:
                stream.write(text.encode())
    return found


def lived(years: int, recipe: str) -> list[dict[str, Any]]:
    """False promotions a year in every world, with a normal interval over years."""
    from pipeline.statistics.nightly import Limits
    from pipeline.statistics.nights import live
    from pipeline.statistics.worlds import WORLDS

    gate = load_recipe(recipe).gate
    night, rows = _nightly(recipe), list[dict[str, Any]]()
    budget = night.false_promotions * (1 - night.anchor_share)
    limits = Limits(gate.margin, gate.alpha, night.most_scenes)
    worlds = [(name, world, True) for name, world in WORLDS.items()]
    worlds.insert(1, ("equal, nothing given back", WORLDS["equal"], False))
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("years", total=len(worlds) * night.nights)
        for k, (name, world, gives_back) in enumerate(worlds):
            done = live(world, years=years, nights=night.nights, budget=budget, most_stake=night.most_stake,
                        limits=limits, batch=night.batch, seed=k, gives_back=gives_back,
                        told=lambda _: bar.advance(task))
            mean, half = float(done.false.mean()), 1.96 * float(done.false.std()) / sqrt(years)
            rows.append({"world": name, "years": years, "false": mean, "low": max(0.0, mean - half),
                         "high": mean + half, "true": float(done.true.mean()), "scenes": done.scenes,
                         "left": float(done.money.mean()), "largest_stake": done.largest, "budget": budget})
    return rows


def measured_power(nights: int, recipe: str) -> dict[str, Any]:
    """Power and scenes of every test at every effect, all at the even stake of a night."""
    import numpy as np

    from pipeline.statistics.nightly import Limits
    from pipeline.statistics.nights import mixed, pair
    from pipeline.statistics.power import fixed_power, fixed_size, fixed_whole, nightly_operating
    from pipeline.statistics.step import operate, synthesize
    from pipeline.statistics.worlds import CHAMPION, SHARED, SHARES

    gate, night = load_recipe(recipe).gate, _nightly(recipe)
    alpha = night.false_promotions * (1 - night.anchor_share) / night.nights
    limits, few = (Limits(gate.margin, gate.alpha, n) for n in (night.most_scenes, STEP_SCENES))
    policy = synthesize(STEP_SCENES, alpha, every=STEP_EVERY, points=33)
    sizes = {f"{power:g} at +{100 * effect:g}": fixed_size(*pair(CHAMPION, CHAMPION + effect, SHARED), alpha, power)
             for effect, power in ((0.05, 0.9), (0.10, 0.9), (0.10, 0.999))}
    planned = sizes["0.9 at +5"]
    rows: list[dict[str, Any]] = []
    for k, effect in enumerate(EFFECTS):
        fixed, broken = (float(x) for x in pair(CHAMPION, CHAMPION + effect, SHARED))
        one, three = (mixed(s, np.full(s.size, fixed), np.full(s.size, broken)) for s in (np.ones(1), SHARES))
        tests = {
            "nightly": nightly_operating(one, alpha, limits, batch=night.batch, nights=nights, seed=k),
            "nightly, three families bounded": nightly_operating(three, alpha, limits, batch=night.batch,
                                                                 nights=nights, seed=k),
            f"nightly, {STEP_SCENES} scenes": nightly_operating(one, alpha, few, batch=STEP_EVERY, nights=nights,
                                                                seed=k),
            f"STEP, {STEP_SCENES} scenes": operate(policy, fixed, broken, CHAMPION - broken),
        }
        told = {name: {"power": o.rejects, "scenes": o.scenes} for name, o in tests.items()}
        for n in (STEP_SCENES, planned):
            told[f"fixed, {n} scenes"] = {"power": fixed_power(n, fixed, broken, alpha), "scenes": float(n)}
        told[f"fixed, {planned} scenes, three families bounded"] = {
            "power": fixed_whole(planned, three, alpha, gate.margin, nights=min(nights, 1000), seed=k),
            "scenes": float(planned)}
        rows.append({"effect": effect, "fixed": fixed, "broken": broken, "tests": told})
    return {"alpha": alpha, "champion": CHAMPION, "shared": SHARED, "nights": nights, "fixed_sizes": sizes,
            "planned": planned, "effects": rows}


def tables(found: dict[str, Any]) -> Iterable[Table]:
    """Both measurements for people."""
    lived_ = Table("world", "false promotions a year", "true ones", "scenes a night", "largest stake")
    for row in found["years"]:
        lived_.add_row(row["world"], f"{row['false']:.4f} [{row['low']:.4f} {row['high']:.4f}]", f"{row['true']:.1f}",
                       f"{row['scenes']:.0f}", f"{row['largest_stake']:.5f}")
    yield lived_
    power = found["power"]
    shown = [row for row in power["effects"] if row["effect"] in SHOWN]
    table = Table("test", *(f"+{100 * row['effect']:g}: power, scenes" for row in shown))
    for name in shown[0]["tests"]:
        rows = [row["tests"][name] for row in shown]
        table.add_row(name, *(f"{row['power']:.3f}, {row['scenes']:.0f}" for row in rows))
    yield table
    sizes = Table("a fixed design with power", "needs scenes")
    for name, n in power["fixed_sizes"].items():
        sizes.add_row(name, str(n))
    yield sizes


def charts(power: dict[str, Any]) -> dict[str, str]:
    """File name -> SVG: power and scenes by effect."""
    from pipeline.report.alone import alone
    from pipeline.report.charts import Line, around, line_chart, shares

    x = [100 * row["effect"] for row in power["effects"]]
    axis = around("gain [points]", x)
    drawn: dict[str, str] = {}
    for kind, title in (("power", "A promotion in one night"), ("scenes", "Scenes that a night plays")):
        names = [name for name in power["effects"][0]["tests"] if "three" not in name]
        lines = [Line(name, x, [row["tests"][name][kind] for row in power["effects"]], colour=k, dashed="fixed" in name)
                 for k, name in enumerate(names)]
        values = [v for line in lines for v in line.y]
        y = shares("promoted") if kind == "power" else around("scenes", values, zero=True)
        drawn[f"nights-{kind}"] = alone(line_chart(title, lines, axis, y), f"{title}, by true gain in points")
    return drawn


def _nightly(recipe: str) -> Any:
    """The nightly part of a recipe."""
    from flows.run.night_by_hand import nightly_order

    return nightly_order(recipe, 0, 0).recipe.gate.nightly
