"""hardcase measure odometry: the figures add up, and an odd request is one line."""

import json


def test_the_study_counts_falls_and_compares_starts_with_the_truth(hardcase, files, tmp_path):
    code, said, told = hardcase("measure", "odometry", str(files["champion"]), "--twin", "3", "--episodes", "6",
                                "--json", str(tmp_path / "odometry.json"))
    assert (code, told) == (0, "")
    found = json.loads((tmp_path / "odometry.json").read_text())
    assert found["cases"] == found["noticed"]["rightly"] + found["noticed"]["wrongly"] > 0
    assert all(found["falls"][kind]["n"] == found["cases"] for kind in found["falls"])
    assert found["errors"]["height"][0] < 0.05 and f"{found['cases']} falls on twins [3]" in said


def test_a_policy_of_another_robot_is_one_line(hardcase, files):
    code, _, told = hardcase("measure", "odometry", str(files["wider"]), "--twin", "3", "--episodes", "2")
    assert code == 2 and "unknown body 'strider'" in told and "Traceback" not in told
