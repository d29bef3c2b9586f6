"""How an expected change is held against the measured one, by hand on three pairs."""

from dataclasses import asdict
from xml.etree import ElementTree

import pytest

from flows.studies.counterfactual import Pair, calibration, draw


def pair(told: float, was: float, half: float = 0.03) -> Pair:
    around = (told, told - half, told + half)
    return Pair(0, 0, "a" * 16, "b" * 16, 3, 3, 0, around, around, (0.0, -0.1, 0.1), (was, was - 0.02, was + 0.02),
                "hold", {"both": 3})


PAIRS = [pair(0.10, 0.12), pair(-0.05, -0.06), pair(0.08, 0.045)]


def test_coverage_bias_and_signs_are_those_that_one_counts_by_hand():
    found = calibration(PAIRS, "disagreements")
    assert (found["pairs"], found["covered"], found["covered_with_error"]) == (3, 2, 3)
    assert found["bias"] == pytest.approx((-0.02 + 0.01 + 0.035) / 3)
    assert found["rmse"] == pytest.approx(((0.02 ** 2 + 0.01 ** 2 + 0.035 ** 2) / 3) ** 0.5)
    assert (found["clear"], found["clear_with_the_same_sign"]) == (3, 3)
    assert found["half_width"] == pytest.approx(0.03) and found["sign_agreement"] == 1.0


def test_the_scatter_plot_is_one_svg_file_with_a_dot_a_pair(tmp_path):
    draw({"pairs": [asdict(p) for p in PAIRS]}, tmp_path / "plot.svg")
    root = ElementTree.parse(tmp_path / "plot.svg").getroot()
    dots = [e for e in root.iter() if e.get("class", "").startswith("dot")]
    assert len(dots) == 3 and "foretold +10.0 [+7.0 +13.0], measured +12.0" in "".join(dots[0].itertext())
