"""YAML files that people write: read, checked against a schema, refused in one line with field, value and rule."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAliasType, cast, get_args, get_origin

import yaml
from pydantic import BaseModel, Tag, ValidationError
from pydantic_core import ErrorDetails

from pipeline.errors import ConfigError


def load_document[Model: BaseModel](file: Path, model: type[Model], *, kind: str, example: str) -> Model:
    """Read one YAML file as a value of `model`.

    Args:
        file: the file.
        model: what it must hold.
        kind: what people call such a file, with its article: 'an ingest map'.
        example: where a whole one can be looked at; ends the mend of every error.

    Raises:
        ConfigError: no such file, not YAML, or a value that breaks a rule; names the file.
    """
    return from_values(load_mapping(file, kind=kind, example=example), model, where=file, example=example)


def load_mapping(file: Path, *, kind: str, example: str) -> dict[str, Any]:
    """Read one YAML file as plain values; see load_document.

    Raises:
        ConfigError: no such file, not YAML, or no mapping; names the file.
    """
    try:
        content: Any = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", where=file, mend=f"name {kind}; {example}") from error
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(f"not YAML: {error.problem}", where=f"{file}{line}", mend=example) from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ConfigError("not a text file of YAML", where=file, mend=f"save it as UTF-8; {example}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{kind} is a mapping, this is {type(content).__name__}", where=file, mend=example)
    return cast(dict[str, Any], content)


def from_values[Model: BaseModel](content: dict[str, Any], model: type[Model], *, where: object,
                                  example: str) -> Model:
    """A value of `model` out of plain values.

    Raises:
        ConfigError: one breaks a rule; says the field, the value and the rule, and how many more there are.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        details = error.errors()
        first = next((d for d in details if d["type"] == "extra_forbidden"), details[0])  # a typo explains the rest
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise ConfigError(_sentence(first) + more, where=where, mend=_mend(model, first, example)) from error


def _sentence(detail: ErrorDetails) -> str:
    field = _dotted(detail["loc"])
    if detail["type"] == "extra_forbidden":
        return f"unknown key {field!r}"
    if detail["type"] == "missing":
        return f"{field!r} is missing"
    rule = detail["msg"].removeprefix("Value error, ")
    if detail["type"] == "value_error":  # such a rule shows its own values
        return f"{field}: {rule}" if field else rule
    shown = repr(detail["input"])
    return f"{field} = {shown if len(shown) <= 60 else shown[:57] + '...'}: {rule[0].lower()}{rule[1:]}"


def _dotted(location: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in location)


def _mend(model: type[BaseModel], detail: ErrorDetails, example: str) -> str:
    if detail["type"] == "extra_forbidden" and (sections := list(_sections(model, detail["loc"][:-1]))):
        return f"use one of: {', '.join(sorted(sections[0].model_fields))}"
    return example


def _sections(kind: Any, location: tuple[int | str, ...]) -> Iterator[type[BaseModel]]:
    """Models that a location leads to; a part that only names the branch of a union chooses that branch."""
    if isinstance(kind, TypeAliasType):
        yield from _sections(kind.__value__, location)
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        part = str(location[0]) if location else ""
        if not location:
            yield kind
        elif (field := kind.model_fields.get(part)) is not None:
            yield from _sections(field.annotation, location[1:])
        elif any(part in get_args(field.annotation) for field in kind.model_fields.values()):
            yield from _sections(kind, location[1:])
    else:
        tags = [a.tag for a in get_args(kind) if isinstance(a, Tag)]
        if tags and location[:1] != (tags[0],):
            return
        steps = 1 if tags or get_origin(kind) in (dict, tuple) else 0
        for argument in get_args(kind):
            yield from _sections(argument, location[steps:])
