"""The shape of what `hardcase why` tells: a tree of causes, and below it what used the thing."""

from collections.abc import Iterable
from typing import Literal

from pydantic import Field

from pipeline.store.facts import some
from schemas.base import Frozen

type Kind = Literal["policy", "version", "group", "episode", "verdict", "hard_case", "run", "raw_log", "conversion",
                    "consent", "checked", "worth", "erased"]


class Used(Frozen):
    """One thing, or things of one kind, that came of what was asked about."""

    kind: str
    title: str = Field(description="what it is called, with its id or a count")
    notes: tuple[str, ...] = Field(default=(), description="what is known of it, one line each")
    ids: tuple[str, ...] = Field(description="of everything that is in it")


class Lineage(Frozen):
    """A thing, what is known of it, and what it came from."""

    kind: Kind
    id: str
    role: str = ""
    facts: dict[str, str] = Field({}, description="what is known, in the order of telling")
    children: tuple["Lineage", ...] = ()
    used_by: tuple[Used, ...] = Field(default=(), description="everything that came of it, causes before effects")


def render(lineage: Lineage) -> str:
    """The tree as indented text, one fact a line."""
    return "\n".join([*_lines(lineage, ""), *_used(lineage.used_by)])


def to_json(lineage: Lineage) -> str:
    """The tree as JSON, for programs."""
    return lineage.model_dump_json(indent=2)


def _lines(node: Lineage, indent: str) -> Iterable[str]:
    yield f"{indent}{node.role + ': ' if node.role else ''}{node.kind.replace('_', ' ')} {node.id}"
    for name, value in node.facts.items():
        yield f"{indent}  {name}: {value}"
    for child in node.children:
        yield from _lines(child, indent + "  ")


def _used(used: tuple[Used, ...]) -> Iterable[str]:
    if used:
        yield "used by:"
    for u in used:
        named = f": {some(u.ids, full=False)}" if len(u.ids) > 1 else ""
        yield f"  {u.title} ({' · '.join(u.notes)}){named}"
