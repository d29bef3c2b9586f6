"""The charts of one loop, from its data."""

from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup

from pipeline.report.charts import Axis, Line, around, line_chart, shares, stacked_bars, steps
from pipeline.report.data import ReportData
from pipeline.report.headline import success
from pipeline.report.text import interval, number, percent, words
from schemas.summary import Generation
from schemas.verdict import Proportion

GREY = 7
"""Palette index of what is there for comparison: the control arm, the first generation."""

type Found = Sequence[tuple[int, Proportion]]
"""(generation, success) in order."""


def hero(data: ReportData) -> Markup:
    """Success that counts most, by generation, loop and control."""
    arms = {"loop": data.result.generations, "control": data.result.control or ()}
    named = {arm: [(g.generation, found) for g in laps if (found := success(g)[1])] for arm, laps in arms.items()}
    laps = data.result.generations
    return _success(f"Success, {words(success(laps[0])[0])}" if laps else "Success", named)


def strata(data: ReportData) -> list[Markup]:
    """Success of every kind of start, by generation."""
    kinds = dict.fromkeys(k for g in data.result.generations for k in g.success if k != "deployment_mix")
    figures = [_success(words(kind).capitalize(), {"loop": _of(data.result.generations, kind),
                                                   "control": _of(data.result.control or (), kind)}) for kind in kinds]
    finer = dict.fromkeys(k for lap in data.laps for k in lap.exam_strata if k not in kinds)
    return figures + [
        _success(words(kind).capitalize(), {"loop": [(lap.generation, lap.exam_strata[kind]) for lap in data.laps
                                                     if kind in lap.exam_strata]}) for kind in finer]


def losses(data: ReportData) -> list[Markup]:
    """Training and held-out loss of every policy, on one scale so that they can be compared."""
    if not data.policies:
        return []
    kinds = (("Training loss", [p.train_loss for p in data.policies]),
             ("Held-out loss", [p.held_out_loss for p in data.policies]))
    everything = [pair for _, curves in kinds for curve in curves for pair in curve]
    x = around("step", (float(step) for step, _ in everything), zero=True)
    y = around("smooth L1", (loss for _, loss in everything), log=True)
    figures: list[Markup] = []
    for title, curves in kinds:
        figures.append(line_chart(title, [
            _aged(p.generation, [float(s) for s, _ in curve], [v for _, v in curve], k, len(curves))
            for k, (p, curve) in enumerate(zip(data.policies, curves, strict=True))
        ], x, y, note="every candidate, on one logarithmic scale"))
    ends = [_plain(title, [(p.generation, curve[-1][1]) for p, curve in zip(data.policies, curves, strict=True)
                           if curve], colour, as_share=False) for colour, (title, curves) in enumerate(kinds)]
    figures.append(line_chart("At the end of training", ends, steps("generation", (a for e in ends for a in e.x)),
                              around("smooth L1", (v for e in ends for v in e.y), zero=True), note="last loss"))
    return figures


def rewards(data: ReportData) -> list[Markup]:
    """Every reward term by tick, one line a generation, later ones stronger."""
    figures: list[Markup] = []
    for term in dict.fromkeys(t for lap in data.laps for t in lap.rewards):
        laps = [lap for lap in data.laps if lap.rewards.get(term)]
        lines = [_aged(lap.generation, range(len(lap.rewards[term])), lap.rewards[term], k, len(laps))
                 for k, lap in enumerate(laps)]
        x = around("tick", (float(v) for line in lines for v in line.x), zero=True)
        y = around("reward", (v for line in lines for v in line.y))
        figures.append(line_chart(words(term).capitalize(), lines, x, y))
    return figures


def data_made(data: ReportData) -> list[Markup]:
    """What augmentation kept, which demonstrations survive, what each version holds."""
    figures: list[Markup] = []
    made = [(lap.generation, lap.augment) for lap in data.laps if lap.augment]
    if kinds := dict.fromkeys(k for _, a in made for k in a.tried):
        lines = [_rates(words(kind), [(g, a.kept.get(kind, 0), a.tried[kind]) for g, a in made if a.tried.get(kind)], c)
                 for c, kind in enumerate(kinds)]
        figures.append(line_chart("Augmentation yield", [line for line in lines if line.x],
                                  steps("generation", (g for g, _ in made)), shares("kept"),
                                  note="share of variants that succeeded and were kept"))
    if survived := [(g, sorted(a.survival.values())) for g, a in made if a.survival]:
        lines = [_aged(g, [100 * (k + 0.5) / len(v) for k in range(len(v))], v, n, len(survived))
                 for n, (g, v) in enumerate(survived)]
        figures.append(line_chart("Survival of each demonstration", lines, Axis(
            "% of demonstrations, worst first", 0.0, 100.0, (0, 25, 50, 75, 100)), shares("survived"),
            note="share of its variants that succeeded"))
    if bars := [(f"generation {lap.generation}", lap.frames_by_source) for lap in data.laps if lap.frames_by_source]:
        figures.append(stacked_bars("Frames by source", [(a, {words(k): float(v) for k, v in b.items()})
                                                         for a, b in bars], "frames"))
    return figures


def failures(data: ReportData) -> list[Markup]:
    """How well the triggers see failures, which families there are, what the shadow says of them."""
    figures: list[Markup] = []
    seen = [(lap.generation, lap.triggers) for lap in data.laps if lap.triggers]
    if seen:
        both = (("precision", [(g, t.precision) for g, t in seen]), ("recall", [(g, t.recall) for g, t in seen]))
        lines = [_plain(name, values, colour) for colour, (name, values) in enumerate(both)]
        figures.append(line_chart("Trigger labels against truth", [line for line in lines if line.x],
                                  steps("generation", (g for g, _ in seen)), shares("share"),
                                  note="triggers see only what the robot senses"))
        figures.append(stacked_bars("Failures by family", [
            (f"generation {g}", {words(k): float(v) for k, v in t.by_family.items()}) for g, t in seen], "cases"))
    if shadow := [(lap.generation, lap.shadow_disagreement) for lap in data.laps if lap.shadow_disagreement]:
        lines = [_plain("on successes", [(g, s[0]) for g, s in shadow], 0, as_share=False),
                 _plain("on failures", [(g, s[1]) for g, s in shadow], 3, as_share=False)]
        figures.append(line_chart("Shadow disagreement", lines, steps("generation", (g for g, _ in shadow)),
                                  around("disagreement", (v for line in lines for v in line.y), zero=True),
                                  note="mean distance of the shadow's action to the champion's"))
    return figures


def times(data: ReportData) -> list[Markup]:
    """Wall time by stage, robot time by generation, and what the robot time bought."""
    laps = data.result.generations
    if not laps:
        return []
    bars = stacked_bars("Wall time by stage", [
        (f"generation {g.generation}", {words(k): v for k, v in g.wall_s.items()}) for g in laps], "s")
    arms = [("loop", laps, 0)] + ([("control", data.result.control, GREY)] if data.result.control else [])
    used = [Line(arm, [float(g.generation) for g in found], [g.robot_s for g in found], colour, dashed=colour == GREY,
                 tips=[f"{arm}, generation {g.generation}: {g.robot_s:,.0f} s" for g in found])
            for arm, found, colour in arms]
    bought = [_against_robot_time(arm, found, colour) for arm, found, colour in arms]
    robot = around("robot time so far [s]", (v for line in used for v in line.y), zero=True)
    measure = words(success(laps[0])[0])
    return [bars,
            line_chart("Robot time used", used, steps("generation", (g.generation for g in laps)), robot,
                       note="seconds so far, deployments and corrections"),
            line_chart("What robot time bought", bought, robot, shares(), note=f"success, {measure}")]


def _against_robot_time(arm: str, laps: Sequence[Generation], colour: int) -> Line:
    found = [(g.robot_s, p) for g in laps if (p := success(g)[1])]
    return Line(arm, [s for s, _ in found], [p.rate for _, p in found], colour, [p.low for _, p in found],
                [p.high for _, p in found], [f"{arm}, {s:,.0f} s: {percent(p.rate)} {interval(p)}" for s, p in found],
                dashed=colour == GREY)


def _success(title: str, arms: Mapping[str, Found]) -> Markup:
    lines = [
        Line(arm, [float(g) for g, _ in found], [p.rate for _, p in found], GREY if arm == "control" else 0,
             [p.low for _, p in found], [p.high for _, p in found],
             [f"{arm}, generation {g}: {percent(p.rate)} {interval(p)}" for g, p in found],
             end=percent(found[-1][1].rate), dashed=arm == "control")
        for arm, found in arms.items() if found
    ]
    return line_chart(title, lines, steps("generation", (a for line in lines for a in line.x)), shares())


def _of(laps: Iterable[Generation], kind: str) -> Found:
    return [(g.generation, g.success[kind]) for g in laps if kind in g.success]


def _rates(name: str, found: Sequence[tuple[int, int, int]], colour: int) -> Line:
    return Line(name, [float(g) for g, _, _ in found], [kept / tried for _, kept, tried in found], colour,
                tips=[f"{name}, generation {g}: {kept} of {tried}" for g, kept, tried in found])


def _plain(name: str, values: Iterable[tuple[int, float | None]], colour: int, *, as_share: bool = True) -> Line:
    known = [(g, v) for g, v in values if v is not None]
    return Line(name, [float(g) for g, _ in known], [v for _, v in known], colour,
                tips=[f"{name}, generation {g}: {percent(v) if as_share else number(v)}" for g, v in known])


def _aged(generation: int, x: Sequence[float], y: Sequence[float], k: int, n: int) -> Line:
    """The k-th of n generations in a family of lines: the first grey, then from faint to strong."""
    first = k == 0 and n > 1
    strength = 0.9 if first else 1.0 if n == 1 else 0.3 + 0.7 * k / (n - 1)
    return Line(f"generation {generation}", x, y, GREY if first else 0, strength=strength)
