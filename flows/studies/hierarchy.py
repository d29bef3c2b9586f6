"""`hardcase measure hierarchy`: upper commands over replaceable lowers, on the arm and on the biped."""

import json as jsonlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from flows.studies.measured import write_json
from pipeline.files import atomic

PARTS = ("arm", "biped")


def run_hierarchy_study(*, seeds: int, attempts: int, parts: tuple[str, ...], policy: Path | None,
                        json: Path | None, svg: Path | None) -> dict[str, Any]:
    """Measure the parts that are asked for, print the tables, and write numbers and picture where asked.

    Args:
        seeds: how many.
        attempts: goals or starts a seed.
        parts: of PARTS; what the file of `json` holds of the other one stays, if it was measured on as many.
        policy: walks in place of those that are trained for the study.
        json: where to write everything.
        svg: where to draw what both parts show.

    Raises:
        ConfigError: another part, or a picture of only one.
    """
    from pipeline.errors import ConfigError, unknown

    found = _before(json, seeds, attempts)

    for part in parts:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
    if svg is not None and {*parts, *found} < set(PARTS):
        raise ConfigError("the picture shows both parts", where="--svg", mend="measure both: leave out --part")
    found |= _measured(seeds, attempts, parts, policy)
    for table in _tables(found):
        Console(width=150).print(table)
    write_json(json, found)
    if svg is not None:
        with atomic(svg) as stream:
            stream.write(picture(found).encode())
    return found


def _before(path: Path | None, seeds: int, attempts: int) -> dict[str, Any]:
    """What a file holds of both parts, where it was measured on as many seeds and attempts."""
    if path is None or not path.exists():
        return {}
    found = jsonlib.loads(path.read_text(encoding="utf-8"))
    if (found.get("seeds"), found.get("attempts")) != (seeds, attempts):
        return {}
    return {part: found[part] for part in PARTS if part in found}


def _measured(seeds: int, attempts: int, asked: tuple[str, ...], policy: Path | None) -> dict[str, Any]:
    from flows.studies import hierarchy_arm, hierarchy_biped

    found: dict[str, Any] = {"seeds": seeds, "attempts": attempts}
    total = sum({"arm": hierarchy_arm, "biped": hierarchy_biped}[part].parts(seeds) for part in asked)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total)
        begun = False

        def told(what: str) -> None:
            nonlocal begun
            bar.update(task, description=what, advance=1 if begun else 0)
            begun = True

        if "arm" in asked:
            found["arm"] = hierarchy_arm.arm_study(seeds=seeds, attempts=attempts, told=told)
        if "biped" in asked:
            found["biped"] = hierarchy_biped.biped_study(seeds=seeds, attempts=attempts, policy=policy, told=told)
    return found


def _tables(found: Mapping[str, Any]) -> Iterator[Table]:
    if "arm" in found:
        yield from _arm_tables(found["arm"])
    if "biped" in found:
        yield from _biped_tables(found["biped"])


def _arm_tables(tasks: Mapping[str, Any]) -> Iterator[Table]:
    shown = Table("asked", "lower", "final [mm]", "to 1 cm [s]", "to 5 mm [s]", "there", "behind command [mm]",
                  "turned off [deg]", "effort", "CPU a tick [us]", title="Arm: medians over goals, 95 % intervals")
    for task, one in tasks.items():
        for name, arm in one["arms"].items():
            shown.add_row(task, name, _value(arm["final_m"], 1000, 2), _value(arm["within_10_mm_s"], 1, 2),
                          _value(arm["within_5_mm_s"], 1, 2), f"{arm['within_5_mm_share']['estimate']:.2f}",
                          _value(arm["behind_m"], 1000, 1), _value(arm["turn_rad"], 57.29578, 1),
                          _value(arm["effort"], 1, 4), f"{1e6 * arm['cpu_s_a_tick']:.0f}")
    yield shown
    pairs = Table("asked", "pair", "nearer at the end", "sooner within 5 mm", "less behind", "less effort",
                  title="Share of goals at which the first is better, 95 % intervals (ties count half)")
    for task, one in tasks.items():
        for pair, told in one["pairs"].items():
            pairs.add_row(task, pair, *(_value(told[name]["better"], 1, 2)
                                        for name in ("final_m", "within_5_mm_s", "behind_m", "effort")))
    yield pairs


def _biped_tables(courses: Mapping[str, Any]) -> Iterator[Table]:
    shown = Table("course", "lower", "attempts a seed", "full", "stood [s]", "waypoints", "CPU s a second of a robot",
                  title="Biped: 95 % intervals over seeds and starts")
    for course, arms in courses.items():
        for lower, arm in arms.items():
            shown.add_row(course, lower, str(arm["attempts"]), _value(arm["full"], 1, 3), _value(arm["length_s"], 1, 1),
                          _value(arm["reached"], 1, 1) if "waypoints" in course else "",
                          f"{arm['lower_cpu_s_a_s']:.4f}")
    yield shown
    speeds = Table("asked [m/s]", "tracked [m/s]", "off, mean [m/s]", "off, worst [m/s]", "aside [m/s]", "attempts",
                   title="Biped: speed of those that stand in each part of the profile")
    for phase in courses["profile"]["policy"]["phases"]:
        if phase["attempts"]:
            numbers = ("asked_m_s", "got_m_s", "off_m_s", "worst_m_s", "aside_m_s")
            speeds.add_row(*(f"{phase[key]:.3f}" for key in numbers), str(phase["attempts"]))
    yield speeds


def _value(interval: Mapping[str, float | None], scale: float, digits: int) -> str:
    """An estimate and its interval; what most attempts never reached is 'never'."""
    def one(value: float | None) -> str:
        return "never" if value is None else f"{scale * value:.{digits}f}"

    estimate = one(interval["estimate"])
    return estimate if estimate == "never" else f"{estimate} [{one(interval['low'])} {one(interval['high'])}]"


def picture(found: Mapping[str, Any]) -> str:
    """Two charts in one SVG file: how hands come near their goals, and speeds asked for and tracked."""
    from pipeline.report.alone import beside

    return beside([(_hands(found["arm"]), "Arm: hand to goal [mm], median"),
                   (_speeds(found["biped"]["profile"]), "Biped: speed forward [m/s], PPO below")])


def _hands(tasks: Mapping[str, Any]) -> Any:
    from flows.studies.hierarchy_arm import SECONDS
    from pipeline.report.charts import Line, around, line_chart

    lines: list[Line] = []
    for colour, name in enumerate(("IK", "MPC")):
        for task, dashed in (("target, nominal", False), ("target, perturbed", True)):
            arm = tasks[task]["arms"][name]
            middle = [1000 * value for value in arm["curve_m"][1]]
            times = [SECONDS * (k + 1) / len(middle) for k in range(len(middle))]
            lines.append(Line(f"{name}, {task.removeprefix('target, ')}", times, middle, colour, dashed=dashed))
    x, y = around("time [s]", (0.0, SECONDS)), around("distance [mm]", (0.1, 500.0), log=True)
    return line_chart("", lines, x, y)


def _speeds(profile: Mapping[str, Any]) -> Any:
    from pipeline.report.charts import Line, around, line_chart

    arm, zero = profile["policy"], profile["zero"]
    middle, asked = arm["got_m_s"][1], arm["asked_m_s"]
    lines = [Line("tracked, median", _tenths(middle), middle, 0),
             Line("asked", _tenths(asked), asked, 1, dashed=True),
             Line("zero action, until half have fallen", _tenths(_half(zero)), _half(zero), 7)]
    x, y = around("time [s]", (0.0, 12.0)), around("forward [m/s]", [*middle, *asked])
    return line_chart("", lines, x, y)


def _tenths(values: list[float]) -> list[float]:
    return [k / 10 for k in range(len(values))]


def _half(arm: Mapping[str, Any]) -> list[float]:
    """The median speed while at least half stand."""
    return [speed for speed, share in zip(arm["got_m_s"][1], arm["standing"], strict=False) if share >= 0.5]
