"""The report as one HTML page that needs nothing but itself."""

from collections.abc import Iterable, Mapping
from itertools import groupby
from types import MappingProxyType

from markupsafe import Markup

from pipeline.report import figures
from pipeline.report.data import ReportData, ShownCase
from pipeline.report.headline import headline
from pipeline.report.rendering import render
from pipeline.report.signals import signals

NOTHING_FOUND: Mapping[str, str] = MappingProxyType({})


def page(data: ReportData) -> str:
    """The report of a loop as HTML; see `render`."""
    return render(
        "template.html.j2", interactive=True, data=data, result=data.result, head=headline(data),
        figures=_figures(data), families=families(data.hard_cases, {f.id: f.name for f in data.families}),
        told={f.name: f for f in data.families}, laps={lap.generation: lap for lap in data.laps})


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
            "losses": _trainings(data) if data.learned else figures.losses(data),
            "rewards": figures.rewards(data), "data": figures.data_made(data),
            "failures": figures.failures(data) + signals(data), "times": figures.times(data)}


def _trainings(data: ReportData) -> list[Markup]:
    """What PPO learnt in each lap: how long attempts last, and every reward term on its own."""
    from pipeline.report.learned import success_charts, term_charts

    return success_charts(data.learned) + term_charts(data.learned)
