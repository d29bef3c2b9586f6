"""Small SVG charts: axes, lines, intervals as bands, stacked bars. Colours come from the page's style sheet."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from pipeline.report.text import number

WIDTH, HEIGHT = 360.0, 216.0
"""User units of a chart; drawn about as wide as a telephone, so that letters keep their size."""
LEFT, RIGHT, TOP, BOTTOM = 42.0, 12.0, 12.0, 34.0
MOST_POINTS = 240
"""A line is thinned to this many points: more than one to a pixel cannot be seen."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a chart; bounds, where given, are drawn as a band and whiskers."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    """Index into the page's palette, 0-7."""
    low: Sequence[float] = ()
    high: Sequence[float] = ()
    tips: Sequence[str] = ()
    """What a pointer on each point shows; lines without tips have no dots."""
    end: str = ""
    """Written at the last point."""
    dashed: bool = False
    strength: float = 1.0
    """Opacity, for a family of lines from old to new."""
    listed: bool = True
    """Whether the legend names it."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Where values go, and which of them are written."""

    label: str
    low: float
    high: float
    ticks: Sequence[float]
    log: bool = False
    percent: bool = False

    def share(self, value: float) -> float:
        """Position of a value between low (0) and high (1)."""
        low, high, value = (math.log10(v) if self.log else v for v in (self.low, self.high, value))
        return min(max((value - low) / (high - low), 0.0), 1.0)

    def write(self, value: float) -> str:
        """A tick as text."""
        return f"{100 * value:.0f}%" if self.percent else f"{value:,.9g}".replace("-", "−")


def shares(label: str = "success") -> Axis:
    """0 to 100 %."""
    return Axis(label, 0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), percent=True)


def steps(label: str, values: Iterable[float]) -> Axis:
    """Whole numbers such as generations, every one a tick while they fit."""
    found = [int(v) for v in values] or [0]
    low, high = min(found), max(found)
    stride = max(1, math.ceil((high - low) / 8))
    pad = 0.25 if high > low else 0.5
    return Axis(label, low - pad, high + pad, [float(v) for v in range(low, high + 1, stride)])


def around(label: str, values: Iterable[float], *, log: bool = False, zero: bool = False) -> Axis:
    """An axis that holds all finite values, with round ticks."""
    found = [v for v in values if math.isfinite(v) and (v > 0 or not log)] + ([0.0] if zero else [])
    if log and found:
        low, high = math.floor(math.log10(min(found))), math.ceil(math.log10(max(found)))
        decades = range(low, max(high, low + 1) + 1)
        return Axis(label, 10.0 ** decades[0], 10.0 ** decades[-1], [10.0 ** d for d in decades], log=True)
    low, high = (min(found), max(found)) if found else (0.0, 1.0)
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    raw = (high - low) / 4
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * next(m for m in (1, 2, 2.5, 5, 10) if m * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return Axis(label, first * step, last * step, [k * step for k in range(first, last + 1)])


def line_chart(title: str, lines: Sequence[Line], x: Axis, y: Axis, *, note: str = "") -> Markup:
    """A figure of lines over a common x axis; values that are not finite interrupt nothing and are left out."""
    body = [_grid(x, y)]
    layers = lines[::-1]  # the first line lies on top
    body += [_band(line, x, y) for line in layers if line.low]
    body += [_line(line, x, y) for line in layers]
    body += [_dots(line, x, y) for line in layers if line.tips]
    body += [_end(line, x, y) for line in layers if line.end]
    named = [line for line in lines if line.listed]
    legend = [_key(line.name, line.colour, line.dashed, line.strength) for line in named] if len(lines) > 1 else []
    kind = "dots" if any(line.tips for line in lines) else "curve"
    frame = Markup(' data-x="{} {} {}" data-y="{} {} {}"').format(x.low, x.high, x.label, y.low, y.high, int(y.log))
    return _figure(title, note, _svg(f"{title}: {y.label} by {x.label}", Markup("").join(body), HEIGHT, kind, frame),
                   legend)


def scatter_chart(title: str, groups: Sequence[Line], x: Axis, y: Axis, *, note: str = "",
                  diagonal: bool = False) -> Markup:
    """A figure of points, those of a group in one colour, with whiskers where bounds are given.

    Args:
        title, x, y, note: as for line_chart.
        groups: points with their tips; nothing connects them.
        diagonal: draw where x and y are equal.
    """
    low, high = max(x.low, y.low), min(x.high, y.high)
    equal = [_line(Line("equal", (low, high), (low, high), 7, dashed=True), x, y)] if diagonal else []
    body = [_grid(x, y), *equal, *(_whiskers(g, x, y) for g in groups if g.low), *(_dots(g, x, y) for g in groups)]
    legend = [_key(g.name, g.colour, block=True) for g in groups] if len(groups) > 1 else []
    frame = Markup(' data-x="{} {} {}" data-y="{} {} {}"').format(x.low, x.high, x.label, y.low, y.high, int(y.log))
    return _figure(title, note, _svg(f"{title}: {y.label} by {x.label}", Markup("").join(body), HEIGHT, "dots", frame),
                   legend)


def stacked_bars(title: str, rows: Sequence[tuple[str, Mapping[str, float]]], unit: str, *, note: str = "") -> Markup:
    """One horizontal bar a row, its parts in the order in which they first appear, the total at its end."""
    parts = list(dict.fromkeys(part for _, values in rows for part in values))
    totals = [sum(values.values()) for _, values in rows]
    longest = max([*totals, 1e-9])
    room, pitch, left = WIDTH - 92.0 - 58.0, 30.0, 92.0
    marks: list[Markup] = []
    for k, ((label, values), total) in enumerate(zip(rows, totals, strict=True)):
        top, start = 6 + pitch * k, left
        marks.append(_text(left - 8, top + 14, label, "end"))
        for part, value in values.items():
            wide = room * max(value, 0) / longest
            marks.append(Markup('<rect class="bar c{}" x="{:.1f}" y="{:.1f}" width="{:.2f}" height="18"><title>{}'
                                "</title></rect>").format(parts.index(part) % 8, start, top, max(wide - 0.8, 0),
                                                          f"{label}, {part}: {number(value)} {unit}"))
            start += wide
        marks.append(_text(start + 6, top + 14, f"{number(total)} {unit}" if len(unit) < 3 else number(total), "start",
                           "strong"))
    legend = [_key(part, k % 8, block=True) for k, part in enumerate(parts)]
    return _figure(title, note, _svg(title, Markup("").join(marks), 12 + pitch * len(rows), "bars"), legend)


def _x(axis: Axis, value: float) -> float:
    return LEFT + (WIDTH - LEFT - RIGHT) * axis.share(value)


def _y(axis: Axis, value: float) -> float:
    return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * axis.share(value)


def _text(x: float, y: float, text: str, anchor: str, kind: str = "tick") -> Markup:
    return Markup('<text class="{}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(kind, x, y, anchor, text)


def _grid(x: Axis, y: Axis) -> Markup:
    floor = HEIGHT - BOTTOM
    marks = [Markup('<line class="{}" x1="{}" x2="{}" y1="{:.1f}" y2="{:.1f}"/>').format(
        "base" if k == 0 else "grid", LEFT, WIDTH - RIGHT, _y(y, v), _y(y, v)) for k, v in enumerate(y.ticks)]
    marks += [_text(LEFT - 6, _y(y, v) + 3.5, y.write(v), "end") for v in y.ticks]
    marks += [_text(_x(x, v), floor + 15, x.write(v), "middle") for v in x.ticks]
    marks.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 4, x.label, "middle", "axis"))
    return Markup("").join(marks)


def _points(line: Line, x: Axis, y: Axis) -> list[tuple[float, float]]:
    pairs = [(a, b) for a, b in zip(line.x, line.y, strict=True) if math.isfinite(b) and (b > 0 or not y.log)]
    stride = max(1, math.ceil(len(pairs) / MOST_POINTS))
    thin = pairs[::stride] + (pairs[-1:] if stride > 1 and (len(pairs) - 1) % stride else [])
    return [(_x(x, a), _y(y, b)) for a, b in thin]


def _path(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in points)


def _line(line: Line, x: Axis, y: Axis) -> Markup:
    return Markup('<polyline class="line c{}{}" points="{}" opacity="{:.2f}" data-name="{}"/>').format(
        line.colour, " dashed" if line.dashed else "", _path(_points(line, x, y)), line.strength, line.name)


def _band(line: Line, x: Axis, y: Axis) -> Markup:
    over = [(_x(x, a), _y(y, b)) for a, b in zip(line.x, line.high, strict=True)]
    under = [(_x(x, a), _y(y, b)) for a, b in zip(line.x, line.low, strict=True)]
    band = Markup('<polygon class="band c{}" points="{}"/>').format(line.colour, _path(over + under[::-1]))
    return band + _whiskers(line, x, y)


def _whiskers(line: Line, x: Axis, y: Axis) -> Markup:
    mark = Markup('<line class="whisker c{}" x1="{:.1f}" x2="{:.1f}" y1="{:.1f}" y2="{:.1f}"/>')
    return Markup("").join(mark.format(line.colour, _x(x, a), _x(x, a), _y(y, high), _y(y, low))
                           for a, high, low in zip(line.x, line.high, line.low, strict=True))


def _dots(line: Line, x: Axis, y: Axis) -> Markup:
    shown = [(_x(x, a), _y(y, b), tip) for a, b, tip in zip(line.x, line.y, line.tips, strict=True) if math.isfinite(b)]
    mark = Markup('<g class="dot c{}"><circle cx="{:.1f}" cy="{:.1f}" r="3.6"/>'
                  '<circle class="hit" cx="{:.1f}" cy="{:.1f}" r="13"/><title>{}</title></g>')
    return Markup("").join(mark.format(line.colour, a, b, a, b, tip) for a, b, tip in shown)


def _svg(alt: str, body: Markup, height: float, kind: str, frame: str = "") -> Markup:
    return Markup('<svg class="{}" viewBox="0 0 {:.0f} {:.0f}" role="img" aria-label="{}"{}>{}</svg>').format(
        kind, WIDTH, height, alt, frame, body)


def _end(line: Line, x: Axis, y: Axis) -> Markup:
    points = _points(line, x, y)
    if not points:
        return Markup("")
    (a, b), below = points[-1], line.dashed
    under = below or b - 9 < 10  # at the upper edge there is no room above the mark
    return _text(min(a + 16, WIDTH), b + (19 if under else -9), line.end, "end", "tick" if below else "strong")


def _key(name: str, colour: int, dashed: bool = False, strength: float = 1.0, *, block: bool = False) -> Markup:
    mark = Markup('<rect class="bar c{}" width="11" height="8" rx="2"/>').format(colour) if block else Markup(
        '<line class="line c{}{}" x1="1" x2="17" y1="4" y2="4" opacity="{:.2f}"/>').format(
            colour, " dashed" if dashed else "", strength)
    return Markup('<li><svg class="key" viewBox="0 0 {} 8" width="{}" aria-hidden="true">{}</svg>{}</li>').format(
        11 if block else 18, 11 if block else 18, mark, name)


def _figure(title: str, note: str, svg: Markup, legend: Sequence[Markup]) -> Markup:
    below = Markup('<ul class="legend">{}</ul>').format(Markup("").join(legend)) if legend else Markup("")
    about = Markup("<small>{}</small>").format(note) if note else Markup("")
    return Markup('<figure class="chart"><figcaption>{}{}</figcaption>{}{}</figure>').format(title, about, svg, below)
