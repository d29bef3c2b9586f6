import json
from pathlib import Path

import pytest

from pipeline.errors import ConfigError
from pipeline.recipes import load_recipe, recipe_names


def write(folder: Path, text: str) -> str:
    (folder / "mine.yaml").write_text(text)
    return str(folder / "mine.yaml")


def refusal(name: str) -> ConfigError:
    with pytest.raises(ConfigError) as refused:
        load_recipe(name)
    assert "\n" not in refused.value.what
    return refused.value


@pytest.mark.parametrize("name", recipe_names())
def test_every_recipe_that_comes_along_is_valid_and_named_like_its_file(name):
    assert load_recipe(name).name == name


def test_a_recipe_is_found_by_path_and_named_after_its_file(tmp_path):
    recipe = load_recipe(write(tmp_path, "train: {steps: 7}"))
    assert (recipe.name, recipe.train.steps) == ("mine", 7)


def test_recipes_are_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_recipe("smoke").generations == 1


def test_an_unknown_recipe_lists_every_known_one():
    error = refusal("defualt")
    assert "defualt" in error.what
    assert all(name in error.mend for name in recipe_names())


def test_a_path_that_is_not_there_is_named():
    assert refusal("no/such.yaml").where == "no/such.yaml"


@pytest.mark.parametrize(
    ("text", "what", "mend"),
    [
        ("train: {steps: -5}", "train.steps = -5: input should be greater than or equal to 1", "schemas/recipe.py"),
        ("train: {stepz: 5}", "unknown key 'train.stepz'", "batch, checkpoint_every, chunk"),
        ("trian: {steps: 5}", "unknown key 'trian'", "augment, collect, dataset"),
        ("gate: {looks: [400, 200]}", "gate: looks (400, 200) must rise", "schemas/recipe.py"),
        ("dataset: {weights: {base: -1}}", "every weight must be above 0", "schemas/recipe.py"),
        ("deploy: {rare_share: .nan}", "deploy.rare_share = nan", "schemas/recipe.py"),
        ("- a\n- b", "a recipe is a mapping, this is list", "name: ..."),
        ("", "a recipe is a mapping, this is NoneType", "name: ..."),
    ],
    ids=["below its limit", "typo in a key", "typo in a section", "order", "negative weight", "NaN", "a list", "empty"],
)
def test_a_broken_rule_is_one_line_with_field_value_and_rule(tmp_path, text, what, mend):
    error = refusal(write(tmp_path, text))
    assert what in error.what
    assert "mine.yaml" in error.where
    assert mend in error.mend


def test_bad_yaml_names_the_line(tmp_path):
    error = refusal(write(tmp_path, "train:\n  steps: [1, 2\nname: x\n"))
    assert error.what.startswith("not YAML")
    assert error.where.endswith(("mine.yaml:3", "mine.yaml:4"))


def test_code_in_yaml_is_refused(tmp_path):
    assert refusal(write(tmp_path, "name: !!python/object/apply:os.getcwd []")).what.startswith("not YAML")


def test_several_faults_are_counted(tmp_path):
    assert refusal(write(tmp_path, "train: {steps: 0, batch: 0}")).what.endswith("(and 1 more)")


def test_asking_for_more_riders_is_another_run_and_not_asking_is_the_same_run_as_ever():
    recipe = load_recipe("default")
    deploy = json.loads(recipe.model_dump_json())["deploy"]
    assert (recipe.deploy.riders, "riders" in deploy) == (1, False), "runs are found again by this JSON"
    more = recipe.model_copy(update={"deploy": recipe.deploy.model_copy(update={"riders": 3})})
    assert json.loads(more.model_dump_json())["deploy"] == deploy | {"riders": 3}


@pytest.mark.parametrize("riders", [0, 17])
def test_a_number_of_riders_that_cannot_be_is_refused_in_one_line(tmp_path, riders):
    error = refusal(write(tmp_path, f"deploy: {{riders: {riders}}}"))
    assert "deploy.riders" in error.what and error.mend
