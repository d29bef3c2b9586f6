"""docs/control.md does what it says, in the order of the page."""

import re
import shlex
from pathlib import Path

import numpy as np

from pipeline.control.table import ARM_LOWERS, ARM_UPPERS, LEGGED_LOWERS, LEGGED_UPPERS

PAGE = (Path(__file__).parents[2] / "docs" / "control.md").read_text(encoding="utf-8")


def test_the_page_runs_from_top_to_bottom(hardcase, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said = []
    for kind, text in re.findall(r"```(python|sh)\n(.*?)```", PAGE, re.DOTALL):
        if kind == "sh":
            code, *_ = hardcase(*shlex.split(text)[1:])
            assert code == 0
            continue
        exec(compile(text, "docs/control.md", "exec"), {})
        said.append(capsys.readouterr().out)
    reach, circle, _ = said
    ik, mpc, path = (np.array(re.findall(r"\d+\.\d*", line), float) for line in reach.strip().splitlines())
    assert (ik < 20).all() and (mpc < 100).all() and len(path) == 4
    assert [line.split()[0] for line in circle.strip().splitlines()] == ["ik", "mpc"]


def test_the_table_of_the_page_names_every_part():
    named = set(re.findall(r"`(\w+)`:", PAGE[:PAGE.index("## Reach")]))
    assert named == {*ARM_UPPERS, *ARM_LOWERS, *LEGGED_UPPERS, *LEGGED_LOWERS}
