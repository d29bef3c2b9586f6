import json
import os
import re
import signal
import sqlite3

import pytest

from flows.service.estimate import plan
from pipeline.recipes import load_recipe
from schemas.summary import LoopResult

one_worker = pytest.mark.xdist_group("finished")

PLAN = plan(load_recipe("smoke"), control=True)


def begun(counting) -> list[str]:
    return [line.removeprefix("begin ") for line in counting.lines() if line.startswith("begin ")]


@pytest.fixture(scope="module")
def finished(tmp_path_factory, counting_in):
    """One whole loop with its control: what was printed and what it left."""
    counting = counting_in(tmp_path_factory.mktemp("finished"))
    counting.done = counting.run("loop", "--recipe", "smoke", "--control", "--json", str(counting.folder / "r.json"))
    assert counting.done.returncode == 0, counting.done.stderr
    return counting


@one_worker
def test_the_loop_turns_in_the_order_that_the_display_announces(finished):
    arms = {"loop": "", "control": "random"}
    assert begun(finished) == [f"{arms[step.arm]}{step.generation} {step.stage}" for step in PLAN]


@one_worker
def test_a_finished_loop_shows_the_table_and_writes_json(finished):
    result = LoopResult.model_validate_json((finished.folder / "r.json").read_text())
    assert [lap.generation for lap in result.generations] == [0, 1]
    assert result.wall_s > 0.5
    assert 50 < result.peak_pss_mb < 2000
    out = finished.done.stdout
    for words in ("common", "rare", ".500 [.40 .60]", "Control", "3 fixed, 1 broken", "Report: "):
        assert words in out
    assert all(len(line) <= 80 for line in out.splitlines() if not line.startswith("Report:"))


@one_worker
def test_nothing_but_one_line_a_stage_reaches_stderr(finished):
    lines = finished.done.stderr.splitlines()
    assert len(lines) == len(PLAN)
    assert all(re.match(r"(control )?generation \d/1  \w+ +\d+\.\d s  \w+$", line) for line in lines)


@one_worker
def test_prefect_remembers_every_stage_as_a_finished_task(finished):
    runs = sqlite3.connect(finished.store / ".prefect/prefect.db")
    assert runs.execute("SELECT state_name, count(*) FROM flow_run GROUP BY 1").fetchall() == [("Completed", 1)]
    assert runs.execute("SELECT state_name, count(*) FROM task_run GROUP BY 1").fetchall() == [("Completed", len(PLAN))]
    assert runs.execute("SELECT key FROM artifact ORDER BY key").fetchall() == [("report",), ("success-by-generation",)]
    names = {name for (name,) in runs.execute("SELECT name FROM task_run")}
    assert {"gate 1", "control gate 1", "report 1"} <= names


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_an_interrupted_loop_stops_cleanly_and_says_how_to_go_on(counting, sign):
    process = counting.start("loop", "--recipe", "smoke", COUNTING_SLEEP_S="1")
    counting.wait_for("begin 0 augment")
    process.send_signal(sign)
    out, err = process.communicate(timeout=240)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "stopped; finished stages are kept, go on with: hardcase loop --resume"
    assert "Traceback" not in out + err
    assert counting.servers() == []


@pytest.mark.parametrize("moment", ["begin 0 train", "end 0 gate"], ids=["inside a stage", "between stages"])
def test_a_killed_loop_resumes_and_redoes_no_finished_stage(counting, eventually, moment):
    process = counting.start("loop", "--recipe", "smoke", "--seed", "7", COUNTING_SLEEP_S="0.3")
    counting.wait_for(moment)
    process.kill()
    process.communicate()
    eventually(lambda: counting.servers() == [], "the end of the orphaned server", 15)
    resumed = counting.run("loop", "--resume")
    assert resumed.returncode == 0, resumed.stderr
    ended = [line for line in counting.lines() if line.startswith("end ")]
    assert len(ended) == len(set(ended)) == len(plan(load_recipe("smoke"), control=False))
    assert "seed 7" in resumed.stdout


def test_a_stage_that_refuses_gives_its_own_three_lines_and_exit_code_2(counting):
    done = counting.run("loop", "--recipe", "smoke", COUNTING_FAIL="train 1")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-3:] == [
        "the arm went through the table",
        "  at:   train 1",
        "  mend: lower the gain",
    ]
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    again = counting.run("loop", "--resume")
    assert again.returncode == 0
    assert begun(counting).count("1 build") == 1
    assert begun(counting).count("1 train") == 2


def test_a_fault_of_ours_is_one_line_too_and_the_whole_story_on_request(counting):
    done = counting.run("loop", "--recipe", "smoke", COUNTING_CRASH="build 0")
    assert done.returncode == 2
    assert "ZeroDivisionError: not meant to happen" in done.stderr
    assert "mend: this is a fault in Hardcase: set HARDCASE_DEBUG=1" in done.stderr
    assert "Traceback" not in done.stderr
    whole = counting.run("loop", "--recipe", "smoke", COUNTING_CRASH="build 0", HARDCASE_DEBUG="1")
    assert "Traceback" in whole.stderr


@one_worker
def test_what_prefect_keeps_of_a_failure_is_json_and_of_a_success_nothing(counting, finished):
    counting.run("loop", "--recipe", "smoke", COUNTING_FAIL="train 0")
    (kept,) = (counting.store / ".prefect/storage").iterdir()
    said = json.loads(kept.read_text())
    assert said["__exc_type__"] == "pipeline.errors.SimulationError"
    assert said["message"].startswith("the arm went through the table")
    storage = finished.store / ".prefect/storage"
    assert not storage.exists() or not list(storage.iterdir())


def test_a_server_that_dies_is_named_with_the_way_on(counting):
    process = counting.start("loop", "--recipe", "smoke", COUNTING_SLEEP_S="2")
    counting.wait_for("begin 0 collect")
    for pid in counting.servers():
        os.kill(pid, signal.SIGKILL)
    _, err = process.communicate(timeout=240)
    assert process.returncode == 2
    assert "the embedded Prefect server ended" in err
    assert "hardcase loop --resume" in err
    assert "Traceback" not in err


def test_a_second_loop_on_one_store_is_refused_and_told_who_holds_it(counting):
    first = counting.start("loop", "--recipe", "smoke", COUNTING_SLEEP_S="1")
    counting.wait_for("begin 0 collect")
    second = counting.run("loop", "--recipe", "smoke", "--seed", "1")
    first.terminate()
    first.communicate()
    assert second.returncode == 2
    assert str(first.pid) in second.stderr
    assert "mend:" in second.stderr


def test_resume_takes_no_other_options(counting):
    done = counting.run("loop", "--resume", "--seed", "3")
    assert done.returncode == 2
    assert "mend: leave the other options away" in done.stderr


def test_resume_on_an_empty_store_says_how_to_begin(counting):
    done = counting.run("loop", "--resume")
    assert done.returncode == 2
    assert "hardcase loop" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_stage_by_hand_goes_on_where_the_loop_stopped(counting):
    counting.run("loop", "--recipe", "smoke", COUNTING_FAIL="train 0")
    done = counting.run("train", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) | {"ids": ...} == {
        "stage": "train", "generation": 0, "ids": ..., "says": "counted", "resumed": False,
    }
    assert "end 0 train" in counting.lines()
