import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.charts import MOST_POINTS, WIDTH, Line, around, line_chart, shares, stacked_bars, steps

values = st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=30)


@given(values)
def test_an_axis_holds_every_value_between_rising_ticks(found):
    axis = around("reward", found)
    unseen = 1e-6 * (max(found) - min(found)) + 1e-9
    assert axis.low <= min(found) + unseen and axis.high >= max(found) - unseen
    assert list(axis.ticks) == sorted(set(axis.ticks)) and 2 <= len(axis.ticks) <= 8


@given(st.lists(st.floats(1e-9, 1e9), min_size=1, max_size=30))
def test_a_logarithmic_axis_ticks_at_powers_of_ten(found):
    axis = around("loss", found, log=True)
    assert axis.low <= min(found) * (1 + 1e-9) and axis.high >= max(found) * (1 - 1e-9)
    assert all(math.isclose(math.log10(t), round(math.log10(t)), abs_tol=1e-9) for t in axis.ticks)


@pytest.mark.parametrize("found", [[], [math.nan, math.inf], [3.0]], ids=["none", "not finite", "one"])
def test_an_axis_needs_no_values_to_be_drawn(found):
    line = Line("a", range(len(found)), found)
    chart = line_chart("Reward", [line], steps("generation", []), around("reward", found))
    assert "nan" not in chart and "inf" not in chart


def test_long_curves_are_thinned_but_keep_their_last_point():
    x = [float(k) for k in range(10_001)]
    chart = line_chart("Loss", [Line("training", x, x)], around("step", x), around("loss", x))
    points = re.search(r'points="([^"]+)"', chart)[1].split()
    assert len(points) <= MOST_POINTS + 1 and points[-1] == f"{WIDTH - 12:.1f},12.0"


def test_many_generations_keep_their_ticks_apart():
    axis = steps("generation", range(100))
    assert len(axis.ticks) <= 9 and axis.ticks[0] == 0


def test_bars_are_as_long_as_their_values():
    chart = stacked_bars("Time", [("generation 0", {"train": 3.0, "gate": 1.0}), ("generation 1", {"train": 8.0})], "s")
    train, gate, later = (float(width) + 0.8 for width in re.findall(r'width="([\d.]+)" height="18"', chart))
    assert train == pytest.approx(3 * gate, rel=0.01)
    assert later == pytest.approx(2 * (train + gate), rel=0.01)
    assert "4 s" in chart and "generation 1, train: 8 s" in chart


def test_names_are_escaped():
    chart = line_chart("<b>", [Line('"><script>', [0], [0.5], tips=["<i>"]), Line("b", [0], [0.1])],
                       steps("generation", [0]), shares())
    assert "<script>" not in chart and "<b>" not in chart and "<i>" not in chart
