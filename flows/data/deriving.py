"""hardcase derive: what a person asks for becomes edits, the edits a version, the version a row of the store."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from flows.data.consents import consents_now
from flows.data.redacting import load_map
from flows.run.material import ancestors_of
from pipeline.check.door import Verdicts
from pipeline.errors import ConfigError, StoreError
from pipeline.lerobot_view.manifest import read_manifest
from pipeline.lerobot_view.opened import FIELDS, Opened, open_version
from pipeline.query import parse
from pipeline.store import Store, store_root
from schemas.dataset import DatasetVersion
from schemas.edits import Add, Drop, Edit, Redact, Relabel, Reweight, Trim
from schemas.episode import Episode
from schemas.finding import CheckVerdict
from stages.derive import derive

ID = re.compile(r"[0-9a-f]{8,16}")


@dataclass(frozen=True, slots=True)
class Order:
    """What is to become of a version, as it was typed."""

    version: str
    add: Sequence[str] = field(default_factory=list[str])
    """VERSION, VERSION=SHARE."""
    drop: Sequence[str] = field(default_factory=list[str])
    keep_where: str | None = None
    trim: Sequence[str] = field(default_factory=list[str])
    """EPISODE:START:STOP."""
    relabel: Sequence[str] = field(default_factory=list[str])
    """EPISODE=OUTCOME."""
    reweight: Sequence[str] = field(default_factory=list[str])
    """EPISODE=FACTOR, QUERY=FACTOR."""
    redact: Path | None = None
    """File of a redaction map."""


def derive_version(order: Order, root: Path | None = None,
                   progress: Callable[[str], None] = lambda told: None) -> DatasetVersion:
    """Derive the version and note it; one that is there already is found again.

    Args:
        order: the edits, applied in the order add, drop, keep, trim, relabel, reweight, redact.
        root: the store; the one of HARDCASE_STORE by default.
        progress: told which video is being redacted.

    Raises:
        HardcaseError: an option cannot be read, or the version cannot be derived.
    """
    with Store.open(root or store_root()) as store:
        parent = named_version(store, order.version, f"VERSION {order.version}")
        others = {v.id: v for v in (named_version(store, _parted(a, "--add")[0], f"--add {a}") for a in order.add)}
        edits = edits_of(order, open_version(store.path(parent.path), parent), others, store)

        def episodes_of(ids: Sequence[str]) -> tuple[list[Episode], list[Episode]]:
            chosen = store.episodes(ids)
            return chosen, ancestors_of(store, chosen)

        version = derive(parent, edits, store=store.root, others=others, consents=consents_now(store),
                         verdicts=_failures(store), episodes_of=episodes_of, progress=progress)
        store.add_version(version)
        return version


def named_version(store: Store, name: str, given: str = "") -> DatasetVersion:
    """A version by its id or the beginning of it; `given` says where that was typed.

    Raises:
        StoreError: there is none, or the name is that of something else.
    """
    kind, id = store.find(name, given)
    if kind != "version":
        raise StoreError(f"{kind.replace('_', ' ')} {id} is no dataset version", where=given or name,
                         mend="list the versions: hardcase datasets")
    return store.version(id)


def edits_of(order: Order, parent: Opened, others: dict[str, DatasetVersion], store: Store) -> list[Edit]:
    """The edits of an order, its queries answered by the version.

    Raises:
        ConfigError: an option that cannot be read, a query that finds nothing, or no option at all.
    """
    edits: list[Edit] = []
    for text in order.add:
        name, share = _parted(text, "--add")
        other = others[store.find(name)[1]]
        here = set(parent.ids)
        new = tuple(e for e in other.episodes if e not in here)
        if not new:
            raise ConfigError(f"version {other.id} has no episode that version {parent.version.id} lacks",
                              where=f"--add {text}", mend="see what differs: hardcase diff A B")
        edits.append(_made(Add, f"--add {text}", version=other.id, episodes=new,
                           share=_usual_share(store, other) if share is None else _number(share, f"--add {text}")))
    if order.drop:
        named = dict.fromkeys(_episode(parent, e, f"--drop {e}", others) for e in order.drop)
        edits.append(Drop(episodes=tuple(named)))
    if order.keep_where:
        edits += _kept(order.keep_where, parent, {i for e in edits if isinstance(e, Drop) for i in e.episodes})
    for text in order.trim:
        parts = text.split(":")
        if len(parts) != 3 or not all(p.isdigit() for p in parts[1:]):
            raise ConfigError(f"{text!r} names no frames", where=f"--trim {text}",
                              mend="write it so: --trim EPISODE:FIRST:AFTER_LAST, such as --trim 0fd4a1b2:10:80")
        edits.append(_made(Trim, f"--trim {text}", episode=_episode(parent, parts[0], f"--trim {text}", others),
                           start=int(parts[1]), stop=int(parts[2])))
    for text in order.relabel:
        name, outcome = _parted(text, "--relabel")
        edits.append(_made(Relabel, f"--relabel {text}", outcome=outcome,
                           episode=_episode(parent, name, f"--relabel {text}", others)))
    edits += [_reweighed(text, parent, others) for text in order.reweight]
    edits += [Redact(map=load_map(order.redact))] if order.redact is not None else []
    if not edits:
        raise ConfigError("nothing is to change", where=f"hardcase derive {order.version}",
                          mend="give one or more of --add, --drop, --keep-where, --trim, --relabel, --reweight, "
                               "--redact")
    return edits


def _usual_share(store: Store, version: DatasetVersion) -> float | None:
    """The share that an imported version was given with --weight; None for any other."""
    return read_manifest(store.path(version.path)).get("imported", {}).get("share_when_added")


def _kept(query: str, parent: Opened, gone: set[str]) -> list[Edit]:
    mask = parse(query, FIELDS).mask(parent.asked)
    leave = tuple(id for id, stays in zip(parent.ids, mask.tolist(), strict=True) if not stays and id not in gone)
    if not mask.any():
        raise ConfigError(f"none of {len(parent)} episodes fits the query", where=f"--keep-where {query!r}",
                          mend=f"see what there is: hardcase datasets {parent.version.id}")
    return [Drop(episodes=leave, reason=f"not ({query})")] if leave else []


def _reweighed(text: str, parent: Opened, others: dict[str, DatasetVersion]) -> Reweight:
    where = f"--reweight {text}"
    query, _, factor = text.rpartition("=")
    query = query.strip()
    number = _number(factor, where)
    if ID.fullmatch(query):
        return _made(Reweight, where, episodes=(_episode(parent, query, where, others),), factor=number)
    mask = parse(query, FIELDS).mask(parent.asked)
    chosen = tuple(parent.ids[k] for k in map(int, np.flatnonzero(mask)))
    if not chosen:
        raise ConfigError(f"none of {len(parent)} episodes fits the query", where=where,
                          mend=f"see what there is: hardcase datasets {parent.version.id}")
    return _made(Reweight, where, episodes=chosen, factor=number, reason=query)


def _episode(parent: Opened, name: str, where: str, others: dict[str, DatasetVersion]) -> str:
    """The one episode of the version, or of those that are added, whose id begins so."""
    known = dict.fromkeys([*parent.ids, *(e for v in others.values() for e in v.episodes)])
    found = [name] if name in known else [id for id in known if id.startswith(name)] if ID.fullmatch(name) else []
    if len(found) != 1:
        what = f"{len(found)} episodes begin with {name}" if found else f"episode {name} is not in the version"
        raise ConfigError(what, where=where, mend=f"use one of: {', '.join((found or list(known))[:5])}, ...")
    return found[0]


def _parted(text: str, option: str) -> tuple[str, str | None]:
    """What stands before and after the = of an option's value."""
    name, sign, value = text.partition("=")
    if (sign and not value) or (not sign and option == "--relabel"):
        raise ConfigError(f"{text!r} has no value after =", where=f"{option} {text}",
                          mend="write it so: --relabel EPISODE=failure, --add VERSION=0.3")
    return name, value if sign else None


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{text!r} is no number", where=where,
                          mend='write it so: --reweight EPISODE=2, --reweight "family == dropped=2", --add VERSION=0.3',
                          ) from None


def _made[E: (Add, Reweight, Trim, Relabel)](kind: type[E], where: str, **values: object) -> E:
    """An edit, or the rule that it breaks in one line."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        fault = error.errors()[0]
        at = ".".join(map(str, fault["loc"])) or kind.__name__.lower()
        raise ConfigError(f"{at}: {fault['msg'].removeprefix('Value error, ')}", where=where,
                          mend="see the ranges: hardcase derive --help") from None


def _failures(store: Store) -> Verdicts:
    """The last verdict on everything whose last verdict is a failure."""
    rows = store.query("SELECT json FROM checked WHERE passed = 0 AND place IN (SELECT max(place) FROM checked"
                       " GROUP BY subject)")
    found = [CheckVerdict.model_validate_json(str(text)) for (text,) in rows]
    return Verdicts({v.subject: v for v in found})
