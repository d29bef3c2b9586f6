"""`hardcase measure hierarchy`, as small as it gets: all numbers in the file, both parts in the picture."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from flows.studies import hierarchy_arm, hierarchy_biped
from pipeline.errors import ConfigError
from pipeline.statistics.bootstrap import bootstrap, mean, median


@pytest.fixture
def short(monkeypatch, tmp_path):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    monkeypatch.setattr(hierarchy_arm, "SECONDS", 0.4)
    monkeypatch.setattr(hierarchy_biped, "SIDLE_STEPS", 4096)
    monkeypatch.setattr(hierarchy_biped, "COURSES", {
        name: course if name == "profile" else replace(course, seconds=0.2)
        for name, course in hierarchy_biped.COURSES.items()})
    return tmp_path


def test_both_parts_are_measured_and_drawn(hardcase, short, walker):
    out, svg = short / "h.json", short / "h.svg"
    few = ("measure", "hierarchy", "--seeds", 1, "--attempts", 2, "--json", out)
    code, said, _ = hardcase(*few, "--part", "arm")
    assert code == 0 and "IK, integral" in said and "nearer at the end" in said
    arm = json.loads(out.read_text())["arm"]
    code, said, told = hardcase(*few, "--part", "biped", "--policy", walker, "--svg", svg)
    assert code == 0, told
    assert "waypoints, sidling" in said and "mpc" in said
    found = json.loads(out.read_text())
    assert found["arm"] == arm  # what was measured before stays
    assert set(found["biped"]) == set(hierarchy_biped.COURSES)
    for task in arm.values():
        assert task["arms"]["IK"]["final_m"]["estimate"] < task["arms"]["zero action"]["final_m"]["estimate"]
        assert task["arms"]["zero action"]["within_5_mm_s"]["estimate"] is None
    assert found["biped"]["profile"]["zero"]["full"]["estimate"] == 0.0
    picture = ElementTree.parse(svg).getroot()
    titles = [text.text for text in picture.iter("{http://www.w3.org/2000/svg}text")]
    assert "Arm: hand to goal [mm], median" in titles and "Biped: speed forward [m/s], PPO below" in titles


@pytest.mark.parametrize(("words", "says"), [
    (("--part", "leg"), "mend: use one of: arm, biped"), (("--part", "arm", "--svg", "a.svg"), "measure both")])
def test_what_cannot_be_measured_is_refused(hardcase, words, says):
    code, _, told = hardcase("measure", "hierarchy", *words)
    assert code == 2 and says in told


def test_a_median_may_be_never_and_its_interval_knows_seeds():
    rng = np.random.default_rng(0)
    never = bootstrap(np.array([[1.0, np.inf, np.inf], [np.inf, np.inf, 2.0]]), median, rng)
    assert (never.estimate, never.high) == (np.inf, np.inf)
    apart = np.repeat([[0.0], [1.0]], 50, axis=1)  # all the spread is between seeds
    found = bootstrap(apart, mean, rng)
    assert (found.low, found.estimate, found.high) == (0.0, 0.5, 1.0)
    with pytest.raises(ConfigError, match=r"mend: give \(seeds, attempts\)"):
        bootstrap(np.zeros(3), mean, rng)
