"""What a redaction map may name in a version, and what it may not, with the reason."""

from collections.abc import Collection, Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType

from pipeline.arrow import pa
from pipeline.errors import ConfigError
from pipeline.footage import FEATURE
from pipeline.lerobot_view.draft import Draft
from pipeline.lerobot_view.layout import BOOKKEEPING, INTERVENTION
from pipeline.lerobot_view.opened import Opened
from schemas.redaction import FieldRule, RedactionMap

TASK, ACTOR = "task", "actor"

_PLACE = "LeRobot finds frames by it"
_CAUSE = "it is a hash that lineage and erasure go by"
_TAUGHT = "it says what teaches; see hardcase derive --help"
KEPT: Mapping[str, str] = MappingProxyType({
    **dict.fromkeys((*BOOKKEEPING, "length"), _PLACE),
    **dict.fromkeys(("episode_id", "parent", "lineage", "blob", "policy"), _CAUSE),
    **dict.fromkeys((INTERVENTION, "outcome", "split", "group", "weight", "generation", "source"), _TAUGHT),
    "tasks": "its name in a map is 'task'", "segments": "of it 'actor' can be hidden",
    "consents": "a consent that is revoked is found by it; give records ids that name nobody",
    "action": "policies would learn what is put there; drop the episode"})
"""Field -> why no map may change it."""


def is_feature(opened: Opened, name: str) -> bool:
    """Whether it is a column of the frames."""
    return name in opened.widths and name not in KEPT


def fields_of(opened: Opened) -> list[str]:
    """Every field that a map may name."""
    own = [n for n in opened.episodes.column_names if "/" not in n and n not in KEPT and not n.startswith("repeated.")]
    return [TASK, ACTOR, *(n for n in opened.widths if n not in KEPT), *own]


def is_text(opened: Opened, name: str) -> bool:
    """Whether the values of a field are texts."""
    return name in (TASK, ACTOR) or (not is_feature(opened, name)
                                     and bool(pa.types.is_string(opened.episodes.schema.field(name).type)))


def refuse_unknown(map: RedactionMap, draft: Draft) -> None:
    """Return when every name of a map means something in all sources of a draft.

    Raises:
        ConfigError: a field, camera, value or episode is unknown or must stay, or a rule does not fit its field.
    """
    ids = set(draft.ids)
    for source in draft.sources:
        for name, rule in map.fields.items():
            _field(source, name, rule)
        cameras = {c.removeprefix(FEATURE) for c in source.cameras}
        for name in map.cameras:
            if name not in cameras:
                raise _unknown(f"camera {name!r} is not in version {source.version.id}", f"cameras.{name}", name,
                               cameras or ["no camera at all"])
    chosen = {f"fields.{n}": r.episodes for n, r in map.fields.items()} | {
        f"cameras.{n}.regions.{k}": region.episodes for n, rule in map.cameras.items()
        for k, region in enumerate(rule.regions)}
    for where, episodes in chosen.items():
        for id in episodes:
            if id not in ids:
                raise _unknown(f"episode {id} is not in the version", where, id, ids)


def _field(opened: Opened, name: str, rule: FieldRule) -> None:
    where = f"fields.{name}"
    if name in KEPT:
        raise ConfigError(f"{name!r} cannot be hidden: {KEPT[name]}", where=_at(where), mend=_use(fields_of(opened)))
    if name.startswith(FEATURE):
        raise ConfigError(f"{name!r} is a camera", where=_at(where),
                          mend=f"name it so: cameras: {{{name.removeprefix(FEATURE)}: faces}}")
    if name not in fields_of(opened):
        raise _unknown(f"unknown field {name!r}", where, name, fields_of(opened))
    text = is_text(opened, name)
    if rule.do == "remove" and name in (TASK, ACTOR):
        raise ConfigError(f"{name!r} cannot be removed: the format needs one", where=_at(where),
                          mend="blank it, replace it, or give a pseudonym")
    if rule.do == "pseudonym" and not text:
        raise ConfigError(f"{name!r} holds numbers, which have no pseudonym", where=_at(where), mend="blank it")
    if rule.do == "replace" and isinstance(rule.to, str) != text:
        raise ConfigError(f"{name!r} holds {'texts' if text else 'numbers'}, not {rule.to!r}", where=_at(where),
                          mend=f"replace it by a {'text in quotes' if text else 'number'}")
    known = names_in(opened, name)
    for value in rule.values:
        if value not in known:
            raise _unknown(f"{name!r} has no value {value!r}", f"{where}.values", value, known or ["no names at all"])


def names_in(opened: Opened, name: str) -> list[str]:
    """Names of a feature's values."""
    names: object = opened.info["features"].get(name, {}).get("names")
    return [str(n) for n in names] if isinstance(names, list) else []  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def _unknown(what: str, where: str, name: str, known: Collection[str]) -> ConfigError:
    near = get_close_matches(name, list(known)[:5000], n=3, cutoff=0.5)
    return ConfigError(what, where=_at(where), mend=_use(near or sorted(known)[:30]))


def _at(where: str) -> str:
    return f"redaction map, {where}"


def _use(names: Iterable[str]) -> str:
    return f"use one of: {', '.join(names)}"
