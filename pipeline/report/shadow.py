"""The shadow report as a page: who was right, what a promotion would change, and every disagreement that was judged."""

from markupsafe import Markup

from pipeline.report import text
from pipeline.report.charts import Axis, Line, scatter_chart, stacked_bars
from pipeline.report.rendering import render
from pipeline.report.text import points
from schemas.counterfactual import Change, Judgement, Right, ShadowReport

ORDER: tuple[Right, ...] = ("both", "champion", "candidate", "neither")
TITLES = {"promote": "The candidate would do better", "roll back": "The former champion would do better",
          "hold": "Not shown to be better"}
HZ = 20.0
"""Ticks a second of the control clock."""


def shadow_page(report: ShadowReport) -> str:
    """HTML with its style and charts inside; every text in it is escaped and nothing is loaded from anywhere."""
    return render(
        "shadow.html.j2", interactive=False, filters={"change": change}, report=report, title=TITLES[report.verdict],
        charts=charts(report), order=ORDER, judgements=sorted(report.judgements, key=lambda j: (j.gain, j.id)), hz=HZ)


def change(found: Change | None) -> str:
    """A change in points with its interval."""
    if found is None:
        return text.MISSING
    low, high = (f"{100 * v:+.1f}".replace("-", "−") for v in (found.low, found.high))
    return f"{points(found.estimate)} [{low}, {high}]"


def charts(report: ShadowReport) -> list[Markup]:
    """Who was right by kind of start, and what each disagreement came to by when it began."""
    made: list[Markup] = []
    if report.judgements:
        rows = [(r.stratum, {v: float(r.right.get(v, 0)) for v in ORDER}) for r in report.rows if r.judged]
        made.append(stacked_bars("Who was right", rows, "", note="disagreements judged, by kind of start"))
        made.append(scatter_chart(
            "What each disagreement came to", [_group(v, k, report) for k, v in enumerate(ORDER) if _of(v, report)],
            Axis("began at [s]", 0.0, 7.5, (0.0, 2.5, 5.0, 7.5)), Axis("gain", -1.0, 1.0, (-1.0, -0.5, 0.0, 0.5, 1.0)),
            note="success of the candidate minus that of the champion from there on"))
    return made


def _of(verdict: Right, report: ShadowReport) -> list[Judgement]:
    return [j for j in report.judgements if j.verdict == verdict]


def _group(verdict: Right, colour: int, report: ShadowReport) -> Line:
    found = _of(verdict, report)
    return Line(verdict, [j.tick / HZ for j in found], [j.gain for j in found], colour,
                low=[j.gain_low for j in found], high=[j.gain_high for j in found], tips=[_tip(j) for j in found])


def _tip(j: Judgement) -> str:
    sides = ", ".join(f"{name} {s.success.successes} of {s.success.n}" for name, s in
                      (("champion", j.champion), ("candidate", j.candidate)))
    return f"{j.episode} at tick {j.tick}, {j.phase}: {sides}"
