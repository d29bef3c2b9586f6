"""Parts run at rates of their own, are replaced by a word, and go on from where they were saved."""

import numpy as np
import pytest

from pipeline.control.config import HierarchyConfig
from pipeline.control.hierarchy import Hierarchy
from pipeline.control.parts import Forgetful
from pipeline.control.table import ARM_LOWERS, ARM_UPPERS, arm_hierarchy
from pipeline.errors import ConfigError

PLANNED = {"lower": "mpc", "sampling": {"samples": 4, "horizon_s": 0.1}}


class Asked(Forgetful):
    """An upper that notes when it is asked."""

    def __init__(self, goals):
        self.goals, self.times = goals, []

    def command(self, sensed, time_s):
        self.times.append(time_s)
        return self.goals


class Holding(Forgetful):
    """A lower that notes how often it is asked, and asks every joint for 0.1 rad beyond its rest."""

    def __init__(self, rest):
        self.rest, self.calls = rest, 0

    def act(self, command, sensed):
        self.calls += 1
        return self.rest + 0.1


def test_each_part_runs_at_its_own_rate(arms):
    plant = arms(False)
    upper, lower = Asked(plant.goals), Holding(plant.rest())
    hierarchy = Hierarchy(plant, upper, lower, upper_hz=5, lower_hz=50)
    began = plant.save()["state"][0, 0]
    for _ in range(25):
        hierarchy.tick()
    assert upper.times == pytest.approx([0.0, 0.2, 0.4])
    assert lower.calls == 25
    assert plant.save()["state"][0, 0] - began == pytest.approx(25 / 50)  # the engine's own clock


@pytest.mark.parametrize(("rates", "field", "mend"), [
    ({"upper_hz": 30, "lower_hz": 100}, "upper_hz", "100 divided by a whole number, such as 33.3"),
    ({"upper_hz": 200, "lower_hz": 100}, "upper_hz", "such as 100"),
    ({"lower_hz": 100, "lower": "mpc", "sampling": {"plan_hz": 40}}, "sampling.plan_hz", "100 divided by a whole")],
    ids=["no whole share", "faster than the lower", "plans between ticks"])
def test_rates_that_do_not_divide_are_refused(rates, field, mend):
    with pytest.raises(ConfigError, match=mend) as refused:
        HierarchyConfig.model_validate(rates)
    assert refused.value.where == field


def test_a_lower_between_the_steps_of_the_engine_is_refused(arms):
    with pytest.raises(ConfigError, match=r"lower_hz to 200 divided by a whole number, such as 66\.6667"):
        arm_hierarchy(HierarchyConfig(lower_hz=60, upper_hz=10), arms(False))


@pytest.mark.parametrize(("words", "names"),
                         [({"upper": "spiral"}, "path, target"), ({"lower": "pid"}, "ik, mpc, zero")])
def test_an_unknown_part_is_refused_with_those_there_are(arms, words, names):
    with pytest.raises(ConfigError, match=f"mend: use one of: {names}"):
        arm_hierarchy(HierarchyConfig.model_validate(words), arms(False))


def test_a_word_of_the_config_replaces_each_part_alone(arms):
    ways = {}
    for upper in ARM_UPPERS:
        for lower in ARM_LOWERS:
            words = {"upper": upper, "lower": lower, "sampling": PLANNED["sampling"]}
            hierarchy = arm_hierarchy(HierarchyConfig.model_validate(words), arms(False))
            for _ in range(10):
                hierarchy.tick()
            ways[upper, lower] = hierarchy.plant.sense().tool
    moved = {key: np.abs(tool - arms(False).sense().tool).max() for key, tool in ways.items()}
    assert moved["target", "zero"] == moved["path", "zero"] < 1e-6
    different = [way.tobytes() for (_, lower), way in ways.items() if lower != "zero"]
    assert len(set(different)) == 4


@pytest.mark.parametrize("lower", [{"lower": "ik"}, PLANNED], ids=["ik", "mpc"])
def test_what_was_saved_goes_on_bit_for_bit(arms, lower):
    config = HierarchyConfig.model_validate({"upper": "path", "upper_hz": 50, "integral_1_s": 2.0, **lower})
    hierarchy = arm_hierarchy(config, arms(True))
    for _ in range(7):
        hierarchy.tick()
    saved = hierarchy.save()
    first = [hierarchy.tick() for _ in range(9)]
    again = arm_hierarchy(config, arms(True))
    again.load(saved)
    second = [again.tick() for _ in range(9)]
    assert np.array_equal(first, second)
    assert np.array_equal(hierarchy.plant.save()["state"], again.plant.save()["state"])
    assert np.array_equal(again.save()["plant/line"], hierarchy.save()["plant/line"])
