"""Hashes of sources: a recording and a version change with the code that decides their bytes, and with no other."""

import ast
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.run.facts import EVERY_RECORDING, RECORDINGS_OF, ROOT, recording_code, software
from pipeline.files import short_id
from stages.build import READING

SPARED = {
    "pipeline/__init__.py": "a docstring",
    "pipeline/deployed.py": "holds recordings that are there; a mean for a report",
    "pipeline/errors.py": "words of refusals; a refused recording has no bytes",
    "pipeline/files.py": "renames and sha256; short_id is pinned below",
    "pipeline/protocols.py": "types without behaviour",
    "pipeline/recording/summary.py": "reads back what was written",
    "pipeline/policies/onnx_guard.py": "refuses a policy or lets it pass as it is",
    "pipeline/signals/curves.py": "means for a report",
    "schemas/base.py": "kinds of ids",
    "schemas/consent.py": "what a record says stands in the metadata itself",
    "schemas/counterfactual.py": "what was judged is no part of a recording; its thresholds stand in config.json",
    "schemas/episode.py": "the metadata holds the whole episode: a new field shows by itself",
    "schemas/hardcase.py": "is not part of a recording",
    "schemas/legged.py": "the metadata holds the whole scene, and with it the start",
    "schemas/recipe.py": "thresholds in force are attached as config.json",
    "schemas/scene.py": "the metadata holds the whole scene",
    "schemas/verdict.py": "proportions are no part of a recording",
}
"""Files that the recording stages reach and that decide no byte of a recording, with the reason."""


def module_file(module: str) -> Path | None:
    base = ROOT.joinpath(*module.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


def runtime_nodes(file: Path) -> Iterator[ast.AST]:
    """Every node of a source file, the inside of functions too, but not what only type checkers see."""
    waiting: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)):
            yield node
            waiting.extend(ast.iter_child_nodes(node))


def homes(module: str, names: list[str]) -> Iterator[Path]:
    """The files that these names of a module come from; a package only hands on what it imports itself."""
    file = module_file(module)
    if file is not None and file.name != "__init__.py":
        yield file
    elif file is not None:
        for name in names:
            if (inside := module_file(f"{module}.{name}")) is not None:
                yield inside
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ImportFrom) and node.module and name in {a.name for a in node.names}:
                    yield from homes(node.module, [name])


def reached(start: str) -> set[str]:
    """Files of ours whose names a file uses, directly or through others."""
    found, waiting = set[Path](), [ROOT / start]
    while waiting:
        file = waiting.pop()
        if file in found:
            continue
        found.add(file)
        for node in runtime_nodes(file):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting.extend(homes(node.module, [alias.name for alias in node.names]))
            elif isinstance(node, ast.Import):
                waiting.extend(path for alias in node.names if (path := module_file(alias.name)) is not None)
    return {path.relative_to(ROOT).as_posix() for path in found}


@pytest.mark.parametrize("stage", RECORDINGS_OF)
def test_the_list_names_what_a_recording_stage_really_uses(stage):
    used, listed = reached(f"stages/{stage}.py") - SPARED.keys(), {*EVERY_RECORDING, *RECORDINGS_OF[stage]}
    assert used - listed == set(), "reached by the stage: list it in flows/run/facts.py, or spare it here with a reason"
    assert listed - used == set(), "no longer reached: take it off the list in flows/run/facts.py"


def test_a_version_hashes_what_reads_frames_and_nothing_else_that_lies_beside_it():
    used = {file for file in reached("pipeline/recording/read.py") if file.startswith("pipeline/recording/")}
    assert used == set(READING), "READING in stages/build.py names the files that read_frames uses"


def test_nothing_is_spared_that_no_recording_stage_reaches():
    assert SPARED.keys() <= set().union(*(reached(f"stages/{stage}.py") for stage in RECORDINGS_OF))


@pytest.mark.parametrize(("file", "changed"), [
    ("pipeline/simulation/world.py", {"collect", "deploy", "deploy_legged", "harvest", ""}),
    ("pipeline/recording/cdr.py", {"collect", "deploy", "deploy_legged", "harvest", ""}),
    ("pipeline/twin/legged_law.py", {"deploy_legged"}),
    ("pipeline/simulation/expert.py", {"collect", "harvest"}),
    ("pipeline/twin/law.py", {"deploy", "harvest"}),
    ("pipeline/simulation/rendering.py", set()),
    ("pipeline/simulation/gym_env.py", set()),
    ("pipeline/recording/read.py", set()),
    ("stages/augment.py", set()),
])
def test_an_edit_shows_only_in_recordings_whose_bytes_it_can_decide(tmp_path, file, changed):
    for layer in ("pipeline", "stages"):
        shutil.copytree(ROOT / layer, tmp_path / layer, ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / file).open("a", encoding="utf-8") as stream:
        stream.write("# a remark\n")
    stages = (*RECORDINGS_OF, "")
    assert {s for s in stages if recording_code(s, tmp_path) != recording_code(s)} == changed


def test_the_hash_stands_in_the_recording_and_its_ids_do_not_move():
    assert software("collect")["software_commit"] == recording_code("collect")[:12]
    assert short_id("episode", "scripted", 7) == "e3d4bba097a26804"
