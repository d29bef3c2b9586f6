"""Queries over episodes as people type them, `outcome == success and not family in (dropped, stall)`: read by a
small grammar of our own and compared by numpy or SQLite; nothing that a person typed is ever run."""

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError

type Kind = Literal["text", "number"]
type Fields = Mapping[str, Kind]
"""Field -> what it holds."""

type Column = Callable[[str], NDArray[Any]]
"""Field -> its value for every row: numbers, or texts and None."""

MEND = 'write it so: "outcome == success and frames >= 40 and family not in (dropped, stall)"'
DEEPEST = 50

_TOKEN = re.compile(r"\s*(?:(?P<sign>==|!=|<=|>=|<|>|\(|\)|,)"
                    r"""|(?P<quoted>"[^"]*"|'[^']*')|(?P<word>[^\s()<>=!,"']+))""")
_ORDER: Mapping[str, Callable[[Any, Any], Any]] = MappingProxyType({
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge})
_KEYWORDS = ("and", "or", "not", "in")


@dataclass(frozen=True, slots=True)
class Compare:
    """One field against values: equal to any of them, or, with an order, against the one."""

    field: str
    op: str
    """`in`, <, <=, > or >=."""
    values: tuple[str | float, ...]

    def mask(self, column: Column) -> NDArray[np.bool_]:
        """The rows for which it holds, shape (n,); a missing value equals nothing and has no order."""
        held = column(self.field)
        if self.op == "in":
            return np.isin(held, self.values) if held.dtype.kind != "O" else _is_any(held, self.values)
        return np.asarray(_ORDER[self.op](held, self.values[0]), np.bool_)

    def sql(self, columns: Mapping[str, str]) -> tuple[str, tuple[str | float, ...]]:
        """The same as an SQL condition and its parameters."""
        at = columns[self.field]
        if self.op == "in":
            return f"coalesce({at} IN ({', '.join('?' * len(self.values))}), 0)", self.values
        return f"coalesce({at} {self.op} ?, 0)", self.values


@dataclass(frozen=True, slots=True)
class Not:
    """The rows that a query leaves out."""

    query: "Query"

    def mask(self, column: Column) -> NDArray[np.bool_]:
        """The rows for which it holds, shape (n,)."""
        return ~self.query.mask(column)

    def sql(self, columns: Mapping[str, str]) -> tuple[str, tuple[str | float, ...]]:
        """The same as an SQL condition and its parameters."""
        text, values = self.query.sql(columns)
        return f"NOT {text}", values


@dataclass(frozen=True, slots=True)
class Both:
    """Two queries joined by `and`, or by `or`."""

    word: str
    left: "Query"
    right: "Query"

    def mask(self, column: Column) -> NDArray[np.bool_]:
        """The rows for which it holds, shape (n,)."""
        left, right = self.left.mask(column), self.right.mask(column)
        return left & right if self.word == "and" else left | right

    def sql(self, columns: Mapping[str, str]) -> tuple[str, tuple[str | float, ...]]:
        """The same as an SQL condition and its parameters."""
        (left, first), (right, second) = self.left.sql(columns), self.right.sql(columns)
        return f"({left} {self.word.upper()} {right})", (*first, *second)


type Query = Compare | Not | Both


def parse(text: str, fields: Fields) -> Query:
    """Read a query: comparisons (==, !=, <, <=, >, >=, in, not in) joined by and, or, not and parentheses.

    Args:
        text: what a person typed; values with blanks stand in quotes.
        fields: what may be asked for.

    Raises:
        ConfigError: names the word that does not fit, and how to write it.
    """
    reader = _Reader(text, fields)
    query = reader.either()
    reader.end()
    return query


class _Reader:
    """Recursive descent over the words of one query."""

    def __init__(self, text: str, fields: Fields) -> None:
        self._text, self._fields, self._at, self._depth = text, fields, 0, 0
        self._words: list[tuple[str, bool]] = []
        place = 0
        while text[place:].strip():
            found = _TOKEN.match(text, place)
            if found is None:
                raise self._wrong(f"{text[place:].strip()[:20]!r} cannot be read")
            quoted = found["quoted"]
            self._words.append((quoted[1:-1], True) if quoted else (found["sign"] or found["word"], False))
            place = found.end()

    def either(self) -> Query:
        query = self._every()
        while self._take("or"):
            query = Both("or", query, self._every())
        return query

    def end(self) -> None:
        if self._at < len(self._words):
            raise self._wrong(f"{self._words[self._at][0]!r} is one word too many")

    def _every(self) -> Query:
        query = self._one()
        while self._take("and"):
            query = Both("and", query, self._one())
        return query

    def _one(self) -> Query:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._wrong(f"more than {DEEPEST} levels of parentheses and nots")
        if self._take("not"):
            query: Query = Not(self._one())
        elif self._take("("):
            query = self.either()
            self._need(")")
        else:
            query = self._compare()
        self._depth -= 1
        return query

    def _compare(self) -> Query:
        field, quoted = self._next("a field")
        if quoted or field not in self._fields:
            raise ConfigError(f"unknown field {field!r}", where=f"query {self._text!r}",
                              mend=f"use one of: {', '.join(sorted(self._fields))}")
        away = self._take("not")
        op, _ = self._next("==, !=, <, <=, >, >= or in")
        if op == "in":
            query: Query = Compare(field, "in", self._several(field))
            return Not(query) if away else query
        if away or op not in ("==", "!=", *_ORDER):
            raise self._wrong(f"{op!r} compares nothing")
        value = self._value(field)
        if op in _ORDER:
            if self._fields[field] != "number":
                raise self._wrong(f"{field} is a text and has no order")
            return Compare(field, op, (value,))
        query = Compare(field, "in", (value,))
        return Not(query) if op == "!=" else query

    def _several(self, field: str) -> tuple[str | float, ...]:
        self._need("(")
        values = [self._value(field)]
        while self._take(","):
            values.append(self._value(field))
        self._need(")")
        return tuple(values)

    def _value(self, field: str) -> str | float:
        word, quoted = self._next("a value")
        if not quoted and (word in _KEYWORDS or not re.match(r"[^()<>=!,]", word)):
            raise self._wrong(f"{word!r} is no value")
        if self._fields[field] == "text":
            return word
        try:
            return float(word)
        except ValueError:
            raise self._wrong(f"{field} is a number, {word!r} is none") from None

    def _next(self, what: str) -> tuple[str, bool]:
        if self._at == len(self._words):
            raise self._wrong(f"it ends where {what} should stand")
        self._at += 1
        return self._words[self._at - 1]

    def _take(self, word: str) -> bool:
        found = self._at < len(self._words) and self._words[self._at] == (word, False)
        self._at += found
        return found

    def _need(self, word: str) -> None:
        if not self._take(word):
            there = repr(self._words[self._at][0]) if self._at < len(self._words) else "the end"
            raise self._wrong(f"{word!r} is missing before {there}")

    def _wrong(self, what: str) -> ConfigError:
        return ConfigError(f"a query that cannot be read: {what}", where=f"query {self._text!r}", mend=MEND)


def _is_any(held: NDArray[Any], values: tuple[str | float, ...]) -> NDArray[np.bool_]:
    """Rows of texts and None that equal one of the values."""
    wanted = set(values)
    return np.fromiter((value in wanted for value in held.tolist()), np.bool_, len(held))
