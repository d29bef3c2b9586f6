"""Recipes from YAML files: found by name, checked, and refused in one line."""

from pathlib import Path
from typing import Any, cast

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pipeline.errors import ConfigError, unknown
from schemas.recipe import Recipe


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
    try:
        content: Any = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(
            f"not YAML: {error.problem}", where=f"{file}{line}", mend="compare with datasets/recipes/default.yaml"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError("not a text file", where=file, mend="save the recipe as UTF-8 YAML") from error
    if not isinstance(content, dict):
        raise ConfigError(
            f"a recipe is a mapping, this is {type(content).__name__}",
            where=file,
            mend="begin with `name: ...`, as in datasets/recipes/default.yaml",
        )
    return recipe_from({"name": file.stem, **cast(dict[str, Any], content)}, file)


def recipe_from(content: dict[str, Any], where: object) -> Recipe:
    """A recipe out of plain values.

    Raises:
        ConfigError: a value breaks a rule; `where` names the source.
    """
    try:
        return Recipe.model_validate(content)
    except ValidationError as error:
        details = error.errors()
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise ConfigError(_sentence(details[0]) + more, where=where, mend=_mend(details[0])) from error


def _sentence(detail: ErrorDetails) -> str:
    """'train.steps = -5: Input should be greater than or equal to 1'."""
    field = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "extra_forbidden":
        return f"unknown key {field!r}"
    if detail["type"] == "missing":
        return f"{field!r} is missing"
    rule = detail["msg"].removeprefix("Value error, ")
    if detail["type"] == "value_error":  # the rule of a whole section already shows its value
        return f"{field}: {rule}" if field else rule
    return f"{field} = {detail['input']!r}: {rule[0].lower()}{rule[1:]}"


def _mend(detail: ErrorDetails) -> str:
    """What to write instead: every key where a key is wrong, else the file with the meaning of each field."""
    section = _section(detail["loc"][:-1])
    if detail["type"] == "extra_forbidden" and section is not None:
        return f"use one of: {', '.join(sorted(section.model_fields))}"
    return "every field with its unit and limits: schemas/recipe.py"


def _section(location: tuple[int | str, ...]) -> type[BaseModel] | None:
    model: type[BaseModel] = Recipe
    for part in location:
        kind = model.model_fields[part].annotation if isinstance(part, str) and part in model.model_fields else None
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
            return None
        model = kind
    return model


def _names() -> str:
    return ", ".join(recipe_names())
