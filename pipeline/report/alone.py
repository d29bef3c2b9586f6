"""Alone: a chart of the report as an SVG file of its own, for a page of documentation."""

import re
from collections.abc import Sequence

from markupsafe import Markup, escape

from pipeline.report.charts import HEIGHT, WIDTH

_LIGHT = ("#0f8f87", "#d9822b", "#5a63d8", "#c6426e", "#5d9b3b", "#9a6b3f", "#3f8fc9", "#7c828a")
_STYLE = (
    "svg{background:#fff}text{font:11px system-ui,-apple-system,'Segoe UI','Liberation Sans',sans-serif;fill:#565c66}"
    ".strong,.heading{fill:#1b1d1f;font-weight:600}.heading{font-size:13px}.grid{stroke:#eeece7}"
    ".base{stroke:#c9c6bf;stroke-width:1.4}.line{fill:none;stroke:var(--k);stroke-width:1.4}"
    ".dashed{stroke-dasharray:5 4}.whisker{stroke:var(--k);opacity:.45}.band{fill:var(--k);opacity:.13}"
    ".dot circle{fill:#fff;stroke:var(--k);stroke-width:1.8}.dot .hit{fill:transparent;stroke:none}"
    ".bar{fill:var(--k)}")
"""The report's own style as far as charts need it, in light colours on a ground of their own."""

HEAD, LINE, SCALE = 30.0, 15.0, 1.8


def beside(charts: Sequence[tuple[Markup, str]]) -> str:
    """Several charts with their titles in one SVG file, from left to right."""
    whole = [alone(chart, title) for chart, title in charts]
    sizes = [re.search(r'width="(\d+)" height="(\d+)"', one) for one in whole]
    wide, high = int(WIDTH * SCALE), max(int(size.group(2)) for size in sizes if size is not None)
    inside = "".join(one.replace("<svg ", f'<svg x="{wide * k}" y="0" ', 1).rstrip() for k, one in enumerate(whole))
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide * len(whole)}" height="{high}" '
            f'viewBox="0 0 {wide * len(whole)} {high}"><rect width="100%" height="100%" fill="#fff"/>{inside}</svg>\n')


def alone(chart: Markup, title: str) -> str:
    """The picture of a chart as a whole SVG file with its title on top and its legend below.

    Args:
        chart: what a function of charts.py gave.
        title: written above it.
    """
    inside = re.search(r"<svg [^>]*viewBox[^>]*>(.*?)</svg>", chart, re.DOTALL)
    assert inside is not None
    keys = re.findall(r'<li><svg class="key"[^>]*>(.*?)</svg>(.*?)</li>', chart, re.DOTALL)
    legend = "".join(f'<g transform="translate(44 {HEIGHT + LINE * k + 4:g})">{mark}'
                     f'<text x="24" y="8">{name}</text></g>' for k, (mark, name) in enumerate(keys))
    height = HEIGHT + HEAD + LINE * len(keys) + (8 if keys else 0)
    colours = "".join(f".c{k}{{--k:{colour}}}" for k, colour in enumerate(_LIGHT))
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH * SCALE:.0f}" height="{height * SCALE:.0f}" '
            f'viewBox="0 {-HEAD:.0f} {WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(title)}">'
            f"<style>{_STYLE}{colours}</style><rect y=\"{-HEAD:.0f}\" width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
            f'<text class="heading" x="8" y="-11">{escape(title)}</text>{inside.group(1)}{legend}</svg>\n')
