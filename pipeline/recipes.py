"""Recipes from YAML files: found by name, checked, and refused in one line."""

from pathlib import Path
from typing import Any

from pipeline.documents import from_values, load_mapping
from pipeline.errors import ConfigError, unknown
from schemas.recipe import Recipe

BEGINNING = "begin with `name: ...`, as in datasets/recipes/default.yaml"
FIELDS = "every field with its unit and limits: schemas/recipe.py"


def recipe_folders() -> tuple[Path, ...]:
    """Where recipes are looked for: below the current folder first, then beside this code."""
    return Path("datasets/recipes"), Path(__file__).parents[1] / "datasets" / "recipes"


def recipe_names() -> tuple[str, ...]:
    """Names of every recipe that `load_recipe` finds without a path."""
    return tuple(sorted({file.stem for folder in recipe_folders() for file in folder.glob("*.yaml")}))


def find_recipe(name: str) -> Path:
    """The file of a recipe, given by name or by path (anything with a slash or ending in .yaml).

    Raises:
        ConfigError: no such recipe; every known name is listed.
    """
    if "/" in name or name.endswith((".yaml", ".yml")):
        if not Path(name).is_file():
            raise ConfigError("no such recipe file", where=name, mend=f"use a path that exists, or a name: {_names()}")
        return Path(name)
    for folder in recipe_folders():
        if (file := folder / f"{name}.yaml").is_file():
            return file
    raise unknown("recipe", name, recipe_names())


def load_recipe(name: str) -> Recipe:
    """Read a recipe by name or path.

    Raises:
        ConfigError: it does not exist, is not YAML, or breaks a rule: the field, the value and the rule in one line.
    """
    file = find_recipe(name)
    return recipe_from({"name": file.stem, **load_mapping(file, kind="a recipe", example=BEGINNING)}, file)


def recipe_from(content: dict[str, Any], where: object) -> Recipe:
    """A recipe out of plain values.

    Raises:
        ConfigError: a value breaks a rule; `where` names the source.
    """
    return from_values(content, Recipe, where=where, example=FIELDS)


def _names() -> str:
    return ", ".join(recipe_names())
