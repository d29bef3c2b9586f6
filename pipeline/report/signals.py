"""Charts of the signals of shadow mode: attempts that failed beside those that succeeded, tick by tick."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from pipeline.report.charts import Axis, Line, around, line_chart
from pipeline.report.data import ReportData
from pipeline.report.text import words
from schemas.summary import Lap

MEANINGS: Mapping[str, tuple[str, str]] = {
    "distance": ("Distance to the training data", "sd of a feature"),
    "revision": ("How far plans were revised", "scales of the action"),
    "apart": ("Disagreement with the nearest candidate", "scales of the action"),
    "spread": ("Spread of champion and candidates", "scales of the action"),
    "flips": ("Candidates whose gripper would go the other way", "share"),
    "warning": ("Early warning", "chance of failure"),
}
"""Signal -> title of its chart, and unit; one that is not named here is shown under its own name."""
COLOURS = {"success": 0, "failure": 3}


def signals(data: ReportData) -> list[Markup]:
    """One chart a signal, of the newest deployment in which enough attempts failed; none where nobody watched."""
    watched = [lap for lap in data.laps if lap.signals]
    telling = [lap for lap in watched if any("failure" in kinds for kinds in lap.signals.values())]
    return [_chart(name, lap) for lap in (telling or watched)[-1:] for name in lap.signals]


def _chart(name: str, lap: Lap) -> Markup:
    title, unit = MEANINGS.get(name, (words(name).capitalize(), ""))
    lines = [_line(kind, values) for kind, values in lap.signals[name].items()]
    x = around("tick", (at for line in lines for at in line.x), zero=True)
    y = Axis(unit, 0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0)) if name in ("warning", "flips") else around(
        unit, (v for line in lines for v in line.y), zero=True)
    return line_chart(title, lines, x, y, note=f"generation {lap.generation} at work, mean of attempts still running")


def _line(kind: str, values: Sequence[float | None]) -> Line:
    known = [(float(tick), v) for tick, v in enumerate(values) if v is not None]
    name = f"attempts that {'failed' if kind == 'failure' else 'succeeded'}"
    return Line(name, [tick for tick, _ in known], [v for _, v in known], COLOURS.get(kind, 7))
