"""Everything behind a thing and everything that came of it, in groups: what `hardcase why` draws and lists."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from json import dumps

from pipeline.store.reader import Reader
from pipeline.store.relations import BACK, FORWARD, Relation
from pipeline.store.titles import describe

MOST = 64
"""Groups that are shown in one direction; beyond, the walk ends and says so."""
ALONE = 6
"""As many things of one kind and generation stand for themselves; more of them become one group."""


@dataclass(frozen=True, slots=True)
class Node:
    """Things of one kind that are told together; often a single one."""

    key: str
    kind: str
    ids: tuple[str, ...]
    title: str
    lines: tuple[str, ...]
    focus: bool = False
    bad: bool = False
    """Whether something is wrong with it: failed, forgotten, incomplete."""


@dataclass(frozen=True, slots=True)
class Graph:
    """Groups and arrows from causes to effects."""

    nodes: tuple[Node, ...]
    edges: tuple[tuple[str, str], ...]
    """Keys of cause and effect."""
    cut: bool
    """Whether there is more that is not shown."""


def graph_of(store: Reader, kind: str, id: str, *, back: bool = True, forward: bool = True) -> Graph:
    """Walk from one thing to all its causes and all its effects, a wave of things at a time.

    Args:
        store: an open store.
        kind, id: the thing.
        back, forward: which ways to go.
    """
    walk = _Walk(store, (kind, id))
    walk.add(kind, [id])
    for wanted, relations, backward in ((back, BACK, True), (forward, FORWARD, False)):
        if wanted:
            walk.spread(relations, backward=backward)
    return walk.graph()


def in_order(graph: Graph) -> list[Node]:
    """The groups, causes before effects; where groups cause each other in a circle, the first found is first."""
    waiting: dict[str, set[str]] = {n.key: set() for n in graph.nodes}
    for cause, effect in graph.edges:
        waiting[effect].add(cause)
    by_key, done = {n.key: n for n in graph.nodes}, dict[str, None]()
    while len(done) < len(waiting):
        left = [key for key in waiting if key not in done]
        free = [key for key in left if waiting[key] <= done.keys()]
        done |= dict.fromkeys(free or left[:1])
    return [by_key[key] for key in done]


@dataclass
class _Walk:
    store: Reader
    focus: tuple[str, str]
    """Kind and id of the thing that was asked about: a group of its own."""
    keys: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    """Kind -> id -> key of the group."""
    groups: dict[str, str] = field(default_factory=dict[str, str])
    """Key -> kind, in the order of finding."""
    edges: dict[tuple[str, str], None] = field(default_factory=dict[tuple[str, str], None])
    """Keys of cause and effect."""
    cut: bool = False

    def add(self, kind: str, ids: Iterable[str]) -> dict[str, str]:
        """Take things in; the keys of everything of this kind."""
        known = self.keys.setdefault(kind, {})
        if new := [id for id in dict.fromkeys(ids) if id not in known]:
            known |= _keys(self.store, kind, new)
            if kind == self.focus[0] and self.focus[1] in new:
                known[self.focus[1]] = f"focus {self.focus[1]}"
            self.groups |= dict.fromkeys((known[id] for id in new if id in known), kind)
        return known

    def spread(self, relations: Mapping[str, tuple[Relation, ...]], *, backward: bool) -> None:
        """Follow relations until nothing new is found, or enough is."""
        kind, id = self.focus
        wave, seen, before = {kind: {id: None}}, {kind: {id}}, len(self.groups)
        while wave:
            if len(self.groups) - before > MOST:
                self.cut = True
                return
            grown: dict[str, dict[str, None]] = {}
            for from_kind, ids in wave.items():
                for to, sql in relations.get(from_kind, ()):
                    pairs = [(str(a), str(b)) for a, b in self.store.query(sql, (dumps([*ids]),))]
                    here, there = self.keys[from_kind], self.add(to, (b for _, b in pairs))
                    joined = dict.fromkeys((here[a], there[b]) for a, b in pairs if b in there)
                    self.edges |= dict.fromkeys((b, a) if backward else (a, b) for a, b in joined)
                    fresh = dict.fromkeys(b for _, b in pairs if b in there and b not in seen.setdefault(to, set()))
                    seen.setdefault(to, set()).update(fresh)
                    grown.setdefault(to, {}).update(fresh)
            wave = {to: ids for to, ids in grown.items() if ids}

    def graph(self) -> Graph:
        """The groups with their words, and the arrows between them."""
        crowd = Counter(key.rpartition(" ")[0] for key in self.groups if key.startswith("="))
        final = {key: key.rpartition(" ")[0] if crowd[key.rpartition(" ")[0]] > ALONE and key.startswith("=") else key
                 for key in self.groups}
        members: dict[str, list[str]] = {final[key]: [] for key in self.groups}
        for known in self.keys.values():
            for id, key in known.items():
                members[final[key]].append(id)
        kinds = {final[key]: kind for key, kind in self.groups.items()}
        nodes = [Node(key, kinds[key], tuple(ids), *describe(self.store, kinds[key], ids),
                      focus=key.startswith("focus ")) for key, ids in members.items()]
        edges = dict.fromkeys((final[a], final[b]) for a, b in self.edges if final[a] != final[b])
        return Graph(tuple(_told(n) for n in nodes), tuple(edges), self.cut)


def _told(node: Node) -> Node:
    bad = any(line.startswith(("incomplete", "saw what", "forgotten", "FAIL", "revoked")) for line in node.lines)
    return Node(node.key, node.kind, node.ids, node.title, node.lines, node.focus, bad)


def _keys(store: Reader, kind: str, ids: list[str]) -> dict[str, str]:
    """Id -> key of its group; '=' begins the key of what stands alone while there are few of it."""
    asked = dumps(ids)
    if kind == "episode":
        rows = store.query("SELECT id, origin || ' ' || generation || (policy NOT NULL) FROM episode"
                           " WHERE id IN (SELECT value FROM json_each(?))", (asked,))
        return {str(id): f"{kind} {key}" for id, key in rows}
    if kind == "hard_case":
        rows = store.query("SELECT id, generation FROM hard_case WHERE id IN (SELECT value FROM json_each(?))",
                           (asked,))
        return {str(id): f"{kind} {generation}" for id, generation in rows}
    if kind in ("version", "policy", "verdict"):
        rows = store.query(f"SELECT id, generation FROM {kind} WHERE id IN (SELECT value FROM json_each(?))", (asked,))
        return {str(id): f"={kind} {generation} {id}" for id, generation in rows}
    return {id: kind if kind == "erased" else f"={kind} {id}" for id in ids}
