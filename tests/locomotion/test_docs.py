"""docs/legged.md does what it says: every example and every command, in the order of the page."""

import re
import shlex
from pathlib import Path

import gymnasium as gym

from pipeline.locomotion.tasks import LEGGED_TASKS

PAGE = (Path(__file__).parents[2] / "docs" / "legged.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```(python|sh)\n(.*?)```", PAGE, re.DOTALL)


def test_the_page_runs_from_top_to_bottom(hardcase, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    for kind, text in EXAMPLES:
        if kind == "python":
            exec(compile(text, "docs/legged.md", "exec"), {})
            continue
        for line in text.strip().splitlines():
            command, *words = shlex.split(line)
            assert command == "hardcase"
            code, said, told = hardcase(*words)
            assert (code, told) == (0, ""), line
            if "evaluate" in words:
                assert all(arm in said for arm in ("policy", "zero action", "random action"))
    assert {folder.name for folder in (tmp_path / "runs").iterdir()} == {"biped", "strider", "push"}


def test_an_environment_takes_a_task_as_a_value():
    task = LEGGED_TASKS["stand"].model_copy(update={"weights": {"upright": 2.0}})
    env = gym.make("hardcase/Stand-v0", task=task)
    env.reset(seed=0)
    assert list(env.step(env.action_space.sample())[4]["reward_terms"]) == ["upright"]


def test_the_table_of_the_page_counts_what_is_observed():
    widths = [3, 3, 2 * 10, 10, 3]
    for name, more in (("hardcase/Stand-v0", 0), ("hardcase/Walk-v0", 2)):
        assert gym.make(name).observation_space.shape == (sum(widths) + more,)
