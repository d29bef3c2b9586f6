import json
import re
import resource

import pytest
import typer.main

from flows.cli import app

COMMANDS = sorted(typer.main.get_command(app).commands)
STAGES = ("collect", "augment", "build", "train", "gate", "release", "deploy", "harvest", "report")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_shows_an_example_that_names_it(command):
    text = typer.main.get_command(app).commands[command].help
    assert re.search(rf"Example: hardcase {command}\b", text)


def test_every_stage_and_service_has_a_command():
    assert {*STAGES, "loop", "doctor", "gc", "why", "study", "recover"} <= set(COMMANDS)


def test_help_costs_less_than_seven_tenths_of_a_second(hardcase):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = hardcase("--help")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0
    assert all(command in done.stdout for command in COMMANDS)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.7  # CPU: others may use the cores


@pytest.mark.parametrize("heavy", ["torch", "lerobot", "mujoco", "prefect", "numpy", "rich.progress"])
def test_the_command_line_loads_nothing_heavy_by_itself(heavy):
    import subprocess
    import sys

    code = f"import flows.cli, sys; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "what", "mend"),
    [
        (("loop", "--recipe", "smke"), "unknown recipe 'smke'", "use one of: act, act-smoke, biped, biped-smoke"),
        (("loop", "--generations", "1", "--recipe", "no/file.yaml"), "no such recipe file", "default, nightly, smoke"),
        (("why", "0123456789abcdef"), "there is no store here", "hardcase loop"),
        (("train",), "there is no store here", "hardcase loop"),
        (("gc",), "there is no store here", "hardcase loop"),
        (("collect", "--run", "0123456789abcdef", "--seed", "1"), "already has its recipe", "either --run"),
        (("recover", "/no/such/folder"), "no such folder", "NAME.mcap.part"),
    ],
    ids=["recipe", "recipe file", "why", "stage", "gc", "run and seed", "recover"],
)
def test_bad_input_is_what_where_and_mend_on_stderr(hardcase, arguments, what, mend):
    done = hardcase(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    first, at, last = done.stderr.splitlines()
    assert what in first
    assert at.startswith("  at:")
    assert last.startswith("  mend:")
    assert mend in last


@pytest.mark.parametrize("field", ["robot", "scene", "task"])
def test_an_unknown_name_in_a_recipe_lists_the_valid_ones(hardcase, tmp_path, field):
    (tmp_path / "odd.yaml").write_text(f"{field}: nonsense")
    done = hardcase("collect", "--recipe", str(tmp_path / "odd.yaml"))
    assert done.returncode == 2
    assert f"unknown {field} 'nonsense'" in done.stderr
    assert "mend: use one of: " in done.stderr


@pytest.mark.parametrize(
    ("arguments", "what", "mend"),
    [
        (("loop", "--generations", "-1"), "invalid value for '--generations': Input should be greater than or equal to"
         " 0", "every option: hardcase loop --help"),
        (("loop", "--seed", "x"), "invalid value for '--seed'", "for example: hardcase loop --generations 3"),
        (("loop", "--generatons", "1"), "no such option: --generatons", "possible options: --generations"),
        (("loop", "--recipe"), "option '--recipe' requires an argument", "every option: hardcase loop --help"),
        (("loop", "smoke"), "got unexpected extra argument(s) (smoke)", "every option: hardcase loop --help"),
        (("why",), "missing argument 'id'", "for example: hardcase why 3f9a1c2b"),
        (("docter",), "no such command 'docter'", "did you mean 'doctor'?"),
        (("nonsense",), "no such command 'nonsense'", "every command: hardcase --help"),
        (("consent", "ad"), "no such command 'ad'", "did you mean 'add'?"),
        (("consent", "add", "--site", "x"), "missing option '--operator'", "hardcase consent add --operator ada"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_words_are_refused_in_three_lines_before_anything_starts(hardcase, arguments, what, mend, tmp_path):
    done = hardcase(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    first, at, last = done.stderr.splitlines()
    assert first.startswith(what)
    assert at == f"  at:   hardcase {' '.join(arguments)}"
    assert last.startswith("  mend: ") and mend in last
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize("arguments", [(), ("consent",)], ids=["hardcase", "a group"])
def test_without_a_command_the_help_is_shown(hardcase, arguments):
    done = hardcase(*arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage: hardcase" in done.stdout and "Commands" in done.stdout


def test_doctor_speaks_json_and_knows_every_part(hardcase):
    checks = {check["name"]: check for check in json.loads(hardcase("doctor", "--json").stdout)}
    assert {"python", "mujoco", "lerobot", "torch", "prefect", "egl", "osmesa", "disk", "cores", "store"} <= set(checks)
    assert checks["python"]["ok"]
    assert all(check["ok"] or check["mend"] for check in checks.values())


def test_doctor_names_a_damaged_store_and_its_mend(hardcase, tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store/catalog.db").write_text("not a database")
    done = hardcase("doctor")
    assert done.returncode == 1
    bad = done.stdout.splitlines()
    line = next(i for i, text in enumerate(bad) if text.startswith("BAD  store"))
    assert bad[line + 1].strip().startswith("mend: ")
