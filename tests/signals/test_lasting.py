"""A disagreement that lasts stops an attempt, where a recipe asks for it."""

import numpy as np
import pytest

from pipeline.protocols import Observation
from pipeline.simulation.tasks import load_task
from pipeline.triggers import TRIGGERS, fired, senses_of
from schemas.recipe import HarvestConfig, LastingConfig, Recipe

ONE, TASK = np.arange(1), load_task("pick-place")
ASKED = HarvestConfig(disagreement=LastingConfig(apart=0.1, ticks=3))


def first_stop(apart, config=ASKED):
    """Tick and trigger that stop a robot on its way, whose candidate is so far from it."""
    senses = senses_of(TASK, 1, config)
    for tick, distance in enumerate(apart):
        state = np.full((1, 16), 0.01 * tick)  # it moves, so that no other trigger has a word
        senses.update(Observation(state, np.ones((1, 7))), ONE)
        senses.differ(np.array([distance]), ONE)
        if (index := fired(senses, ONE)[0]) >= 0:
            return tick, list(TRIGGERS)[index]
    return None


@pytest.mark.parametrize(("apart", "stop"), [
    ([0.2] * 5, (2, "disagreement")), ([0.2, 0.2, 0.1, 0.2, 0.2, 0.2], (5, "disagreement")),
    ([0.2, np.nan, 0.2, np.nan, 0.2], (4, "disagreement")), ([0.1] * 30, None), ([np.nan] * 30, None),
], ids=["it lasts", "it was interrupted", "silence does not end it", "it is not large enough", "nobody answers"])
def test_it_fires_once_every_candidate_has_been_far_enough_for_long_enough(apart, stop):
    assert first_stop(apart) == stop


def test_nobody_who_did_not_ask_for_it_is_stopped_by_it():
    assert first_stop([9.0] * 30, HarvestConfig()) is None


def test_a_recipe_that_does_not_speak_of_it_keeps_its_identity():
    assert "disagreement" not in Recipe(name="a").model_dump_json()
    spoken = Recipe(name="a", harvest=ASKED)
    assert Recipe.model_validate_json(spoken.model_dump_json()) == spoken
