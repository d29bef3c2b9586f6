"""Message definitions in IDL (`ros2idl`, `omgidl`), parsed into the same types as `ros2msg`.

Source: OMG IDL 4.2, 7.4 (the grammar); docs.ros.org, "Mapping of ROS messages to IDL". Unions, optional members and
sequences of arrays are refused: plain CDR has no one layout for them here.
"""

import re
from collections.abc import Iterator
from math import prod
from typing import NoReturn

from pipeline.errors import RecordingError
from pipeline.logs.ros2_types import MEND, TIMES, Count, Member, Types, short

_TOKEN = re.compile(r'//[^\n]*|/\*.*?\*/|^[ \t]*#[^\n]*|^=+[ \t]*$|^IDL:[^\n]*|"(?:\\.|[^"\\])*"'
                    r"|(?P<token>(?:::)?[A-Za-z_]\w*(?:::\w+)*|0[xX][\da-fA-F]+|[\d.]+(?:[eE][+-]?\d+)?[fFdD]?|'.'|\S)",
                    re.DOTALL | re.MULTILINE)
_WORDS = {
    "boolean": "bool", "octet": "byte", "char": "char", "short": "int16", "long": "int32", "long long": "int64",
    "unsigned short": "uint16", "unsigned long": "uint32", "unsigned long long": "uint64", "float": "float32",
    "double": "float64", "string": "string", "wstring": "wstring",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
"""Type in IDL -> type in a message definition."""

type Kind = tuple[str, Count]


def parse_idl(name: str, text: str, where: object) -> Types:
    """All types that an IDL text defines.

    Raises:
        RecordingError: it is no IDL, lacks `name`, or holds what has no plain layout.
    """
    parser = _Parser(text, where)
    try:
        parser.definitions("")
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"the IDL of {name} cannot be read: {error}", where=where, mend=MEND) from None
    types = {short(full): members for full, members in parser.types().items()}
    if short(name) not in types:
        raise RecordingError(f"the IDL does not define {name}", where=where, mend=MEND)
    return types


class _Parser:
    def __init__(self, text: str, where: object) -> None:
        self._tokens: Iterator[str] = (match["token"] for match in _TOKEN.finditer(text) if match["token"])
        self._where = where
        self._next = next(self._tokens, "")
        self._structs: dict[str, list[tuple[str, str, Count]]] = {}
        self._aliases: dict[str, Kind] = {}
        self._numbers: dict[str, int] = {}

    def types(self) -> Types:
        """The structs, their members' types looked up."""
        return {full: tuple(self._member(full, *member) for member in members)
                for full, members in self._structs.items()}

    def definitions(self, scope: str) -> None:
        """What stands in a module, up to its end; ValueError on what is no IDL."""
        while self._next not in ("", "}"):
            word = self._take()
            if word == "module":
                inner = self._take()
                self._expect("{")
                self.definitions(f"{scope}{inner}::")
                self._expect("}")
            elif word == "struct":
                self._struct(scope)
            elif word == "typedef":
                kind = self._type()
                for alias, count in self._declarators(kind[1]):
                    self._aliases[scope + alias] = kind[0], count
                continue
            elif word == "enum":
                self._aliases[scope + self._take()] = "uint32", "one"
                self._skip("{", "}")
            elif word == "const":
                self._constant(scope)
                continue
            elif word == "@":
                self._annotation()
                continue
            elif word != ";":
                self._fail(f"{word!r} is not understood")
            if self._next == ";":
                self._take()

    def _struct(self, scope: str) -> None:
        full = scope + self._take()
        self._expect("{")
        members = self._structs.setdefault(full, [])
        while self._next != "}":
            if self._next == "@":
                self._take()
                if self._annotation() == "optional":
                    self._fail(f"{full} has an optional member")
                continue
            kind, count = self._type()
            members += [(name, kind, times) for name, times in self._declarators(count)]
        self._expect("}")

    def _type(self) -> Kind:
        word = self._take()
        if word == "sequence":
            self._expect("<")
            kind, count = self._type()
            if count != "one":
                self._fail("a sequence of sequences has no plain layout here")
            self._bound()
            return kind, "many"
        while f"{word} {self._next}".startswith(("unsigned ", "long long", "long double")) and (
                self._next in ("short", "long", "double")):
            word += f" {self._take()}"
        if word in ("string", "wstring") and self._next == "<":
            self._take()
            self._bound()
        return word, "one"

    def _bound(self) -> None:
        """The rest of <..., 10>: the bound says nothing about the layout."""
        while self._take() != ">":
            pass

    def _declarators(self, count: Count) -> list[tuple[str, Count]]:
        found: list[tuple[str, Count]] = []
        while True:
            name, sizes = self._take(), list[int]()
            while self._next == "[":
                self._take()
                word = self._take()
                sizes.append(int(word, 0) if word[0].isdigit() else self._named(word))
                self._expect("]")
            if sizes and count != "one":
                self._fail(f"{name} is an array of sequences, which has no plain layout here")
            found.append((name, prod(sizes) if sizes else count))
            if self._take() != ",":
                return found

    def _named(self, word: str) -> int:
        """A constant, by its last name."""
        if (value := self._numbers.get(word.split("::")[-1])) is None:
            self._fail(f"{word} is no number")
        return value

    def _constant(self, scope: str) -> None:
        self._type()
        name = self._take()
        self._expect("=")
        value = list(iter(self._take, ";"))
        if len(value) == 1 and value[0][0].isdigit() and "." not in value[0]:
            self._numbers[name] = int(value[0], 0)

    def _annotation(self) -> str:
        name = self._take()
        if self._next == "(":
            self._skip("(", ")")
        return name

    def _skip(self, opening: str, closing: str) -> None:
        self._expect(opening)
        depth = 1
        while depth:
            word = self._take()
            depth += (word == opening) - (word == closing)

    def _take(self) -> str:
        word, self._next = self._next, next(self._tokens, "")
        if not word:
            self._fail("it ends early")
        return word

    def _expect(self, word: str) -> None:
        if (found := self._take()) != word:
            self._fail(f"{found!r} stands where {word!r} should")

    def _fail(self, what: str) -> NoReturn:
        raise ValueError(what)

    def _member(self, full: str, name: str, kind: str, count: Count) -> Member:
        """A member with its type's own name: aliases are followed, scopes are searched from the inside."""
        for _ in range(len(self._aliases) + 1):
            if kind in _WORDS:
                return Member(name, _WORDS[kind], count)
            if short(kind) in TIMES and "::" in kind:
                return Member(name, short(kind), count)
            scopes = full.split("::")
            places = ["::".join([*scopes[:k], kind.removeprefix("::")]) for k in range(len(scopes) - 1, -1, -1)]
            place = next((p for p in places if p in self._structs or p in self._aliases), "")
            if place in self._structs:
                return Member(name, short(place), count)
            if not place:
                break
            kind, inner = self._aliases[place]
            if inner != "one" and count != "one":
                break
            count = inner if count == "one" else count
        raise RecordingError(f"{full}.{name} is of type {kind}, which the IDL does not define or which has no plain "
                             "layout", where=self._where, mend=MEND)
