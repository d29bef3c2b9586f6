"""Reporting of a legged robot: what its trainings learnt, and film strips of its falls."""

import json

import numpy as np

from flows.run.reporting import FRAMES
from flows.run.steps import Steps
from flows.run.steps_api import Progress
from pipeline.errors import SimulationError
from pipeline.locomotion.tasks import load_legged_task
from pipeline.ppo.fitting import CURVE
from pipeline.recording import read_episode
from pipeline.report.data import FilmStrip
from pipeline.report.learned import Learned
from pipeline.simulation.rendering import FilmCamera, View
from pipeline.twin.legged import draw_legged_twin, twin_robots
from schemas.hardcase import HardCase

FAR, AIM = 2.2, 0.8
"""How far the camera stands, and how high it looks, in heights of the robot's base."""


def learned(steps: Steps) -> tuple[Learned, ...]:
    """The trainings of a run with their curves, in the order of its laps."""
    task = load_legged_task(steps.recipe.task)
    found: list[Learned] = []
    for policy in steps.store.policies(run=steps.run):
        curve = json.loads((steps.store.path(policy.checkpoint) / CURVE).read_text(encoding="utf-8"))["curve"]
        name = f"generation {policy.generation}"
        found.append(Learned(group=name, name=policy.id, task=task, curve=curve))
    return tuple(found)


def legged_strips(steps: Steps, cases: list[HardCase],
                  progress: Progress) -> tuple[dict[str, FilmStrip], tuple[str, ...]]:
    """Hard case id -> frames from where its start lies to the fall, and why there are none where nothing renders."""
    if not cases:
        return {}, ()
    first = steps.store.episode(cases[0].episode)
    robots = twin_robots(draw_legged_twin(steps.twin), [first.scene], threads=1)
    tall, made = robots.body.height_m, dict[str, FilmStrip]()
    try:
        with FilmCamera(robots.setup.model, width=240, height=180) as film:
            for k, case in enumerate(cases):
                _, trace = read_episode(steps.store.blob(str(steps.store.episode(case.episode).blob)))
                ticks = np.linspace(case.begins or 0, len(trace) - 1, FRAMES).astype(int)
                x, y = trace.sim_state[ticks, 1:3].mean(axis=0)  # after the time: where the base is
                film.look(View(look_at_m=(float(x), float(y), AIM * tall), distance_m=FAR * tall, azimuth_deg=130.0,
                               elevation_deg=-15.0))
                labels = tuple(f"{t / trace.hz:.1f} s" for t in ticks[:-1])
                made[case.id] = FilmStrip(film.strip(trace.sim_state[ticks]), (*labels, case.trigger))
                progress(k + 1, len(cases))
    except SimulationError as error:
        return made, (f"No film strips: {error.what}. {error.mend}",)
    return made, ()
