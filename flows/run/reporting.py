"""Reporting: gathers what the report shows, film strips included, and writes the page."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flows.run import facts, summary
from flows.run.steps_api import Progress
from flows.service.memory import tree_pss_mb
from flows.service.running import running
from flows.service.session import since_start_s
from pipeline.errors import SimulationError
from pipeline.recording import read_episode
from pipeline.report.data import FilmStrip, ReportData, ShownCase
from pipeline.simulation.rendering import CLOSE_UP, FilmCamera
from pipeline.twin.twin import draw_twin, twin_setup
from schemas.hardcase import HardCase
from schemas.mining import Family
from stages.report import report

if TYPE_CHECKING:
    from flows.run.steps import Steps
    from pipeline.report.learned import Learned

type Strips = tuple[dict[str, FilmStrip], tuple[str, ...]]
"""Hard case id -> frames of its attempt, and notes for the reader where something is missing."""
type StripsOf = Callable[["Steps", list[HardCase], Progress], Strips]

STRIPS = 12
"""Hard cases with a film strip; one of each family first."""
FRAMES = 5


def write_report(steps: "Steps", progress: Progress, strips_of: "StripsOf | None" = None,
                 learned: "tuple[Learned, ...]" = ()) -> Path:
    """Write the page of a run, whole, and return its path.

    Args:
        steps: the run.
        progress: told (film strips made, film strips in all).
        strips_of: makes the film strips; those of the arm where None.
        learned: trainings by reinforcement with their curves.
    """
    page = steps.store.root / "reports" / f"{steps.run}.html"
    cases = steps.store.hard_cases(run=steps.run)
    families = steps.store.families(run=steps.run)
    strips, notes = (strips_of or film_strips)(steps, _choose(cases, families), progress)
    versions = steps.store.versions(run=steps.run)
    counts = {v.id: _by_origin(steps, v.episodes) for v in versions}
    active = running()
    peak_mb = active.peak_mb() if active else tree_pss_mb()
    result = steps.result().model_copy(update={"wall_s": since_start_s(), "peak_pss_mb": peak_mb})
    data = ReportData(
        recipe=steps.recipe, command=steps.store.history(steps.run)[-1].command, result=result,
        laps=summary.laps(steps), policies=tuple(steps.store.policies(run=steps.run)),
        verdicts=tuple(steps.store.verdicts(run=steps.run)), versions=tuple(versions),
        hard_cases=tuple(ShownCase(c, strips.get(c.id)) for c in cases), families=tuple(families),
        episodes_by_source=counts, learned=learned,
        software={**facts.versions(), "commit": facts.commit()}, store=_counts(steps), notes=notes)
    return report(data, page)


def _by_origin(steps: "Steps", episodes: tuple[str, ...]) -> dict[str, int]:
    counted: dict[str, int] = {}
    for episode in steps.store.episodes(episodes):
        counted[episode.origin] = counted.get(episode.origin, 0) + 1
    return counted


def _counts(steps: "Steps") -> dict[str, int]:
    tables = ("episode", "version", "policy", "verdict", "hard_case")
    return {t: int(str(steps.store.query(f"SELECT count(*) FROM {t}")[0][0])) for t in tables}


def _choose(cases: list[HardCase], families: list[Family]) -> list[HardCase]:
    """In turn from every family, medoids first."""
    medoids = {f.medoid for f in families}
    cases = sorted(cases, key=lambda c: c.episode not in medoids)
    names = dict.fromkeys(c.found or c.family for c in cases)
    groups = [[c for c in cases if (c.found or c.family) == name] for name in names]
    turns = (f[k] for k in range(max(map(len, groups), default=0)) for f in groups if k < len(f))
    return list(turns)[:STRIPS]


def film_strips(steps: "Steps", cases: list[HardCase],
                progress: Progress) -> Strips:
    """Hard case id -> frames of its attempt, and why there are none where nothing can be rendered."""
    if not cases:
        return {}, ()
    model = twin_setup(draw_twin(steps.twin), steps.recipe.robot, steps.recipe.scene).model
    made: dict[str, FilmStrip] = {}
    try:
        with FilmCamera(model, camera=CLOSE_UP, width=240, height=180) as film:
            for k, case in enumerate(cases):
                episode, trace = read_episode(steps.store.blob(str(steps.store.episode(case.episode).blob)))
                model.geom_size[model.geom("object").id] = episode.scene.object_half_m
                ticks = np.linspace(0, len(trace) - 1, FRAMES).astype(int)
                labels = tuple(f"{t / trace.hz:.1f} s" for t in ticks[:-1])
                made[case.id] = FilmStrip(film.strip(trace.sim_state[ticks]), (*labels, case.trigger))
                progress(k + 1, len(cases))
    except SimulationError as error:
        return made, (f"No film strips: {error.what}. {error.mend}",)
    return made, ()
