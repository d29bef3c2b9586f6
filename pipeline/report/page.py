"""The report as one HTML page that needs nothing but itself."""

import base64
import hashlib
from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from pathlib import Path
from types import MappingProxyType

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pipeline.report import figures, text
from pipeline.report.data import ReportData, ShownCase
from pipeline.report.headline import headline
from pipeline.report.signals import signals

HERE = Path(__file__).parent

NOTHING_FOUND: Mapping[str, str] = MappingProxyType({})


def page(data: ReportData) -> str:
    """HTML with its style, script, charts and pictures inside; every text in it is escaped.

    The content security policy admits our one style and our one script by their hashes and nothing
    from anywhere else: not even a hostile name that escaped the escaping could load or run something.
    """
    environment = Environment(loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    filters: dict[str, Callable[..., object]] = {
        "percent": text.percent, "interval": text.interval, "points": text.points, "p": text.p_value,
        "p_equals": text.p_equals, "number": text.number, "duration": text.duration, "words": text.words}
    environment.filters |= filters  # pyright: ignore[reportUnknownMemberType]
    style, script = (HERE / "style.css").read_text("utf-8"), (HERE / "script.js").read_text("utf-8")
    policy = (f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
              "base-uri 'none'; form-action 'none'")
    return environment.get_template("template.html.j2").render(
        data=data, result=data.result, head=headline(data), figures=_figures(data),
        families=families(data.hard_cases, {f.id: f.name for f in data.families}),
        told={f.name: f for f in data.families}, laps={lap.generation: lap for lap in data.laps},
        policy=policy, style=Markup(style), script=Markup(script))


def families(cases: Iterable[ShownCase], found: Mapping[str, str] = NOTHING_FOUND) -> list[tuple[str, list[ShownCase]]]:
    """Hard cases by family, the largest family first, each in the order of generation and id.

    Args:
        cases: all of them.
        found: id of a found family -> its name; a case that belongs to none is told by trigger and subtask.
    """
    def name(shown: ShownCase) -> str:
        return found.get(shown.case.found or "", shown.case.family)

    ranked = sorted(cases, key=lambda shown: (name(shown), shown.case.generation, shown.case.id))
    groups = [(family, list(members)) for family, members in groupby(ranked, key=name)]
    return sorted(groups, key=lambda group: (-len(group[1]), group[0]))


def _figures(data: ReportData) -> dict[str, list[Markup]]:
    return {"hero": [figures.hero(data)] if data.result.generations else [], "strata": figures.strata(data),
            "losses": figures.losses(data), "rewards": figures.rewards(data), "data": figures.data_made(data),
            "failures": figures.failures(data) + signals(data), "times": figures.times(data)}


def _digest(inline: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(inline.encode()).digest()).decode()
