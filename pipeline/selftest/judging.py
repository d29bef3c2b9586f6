"""Plant every fault, let the checks look, and say which were caught and which clean data was accused."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.files import short_id
from pipeline.selftest.material import REFUSED, Fault, Judge, Material, Seen, Site
from schemas.contract import Contract

PLANTS = 3
"""Recordings that each fault is planted in, at other places and in other sizes; all must be caught."""


@dataclass(frozen=True, slots=True)
class Planted:
    """What became of one fault."""

    name: str
    fault: Fault
    files: tuple[Path, ...]
    """Where it was planted."""
    caught_by: tuple[str, ...]
    """The checks meant for it that saw it every time; empty: it was missed at least once."""
    also: tuple[str, ...]
    """Other checks that saw it at least once."""
    said: str
    """What the first finding says; where missed, what came instead."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """Clean data that was accused."""

    where: Path
    said: str


@dataclass(frozen=True, slots=True)
class Result:
    """What the self-test found out about the checks."""

    planted: tuple[Planted, ...]
    clean_episodes: int
    clean_datasets: int
    rendered: bool
    """Whether cameras saw rendered pictures; drawn ones where nothing renders."""
    alarms: tuple[Alarm, ...]

    @property
    def missed(self) -> tuple[Planted, ...]:
        """Faults that no check meant for them saw every time."""
        return tuple(p for p in self.planted if not p.caught_by)

    @property
    def passed(self) -> bool:
        """All faults caught, nothing clean accused."""
        return not self.missed and not self.alarms


def run(material: Material, faults: Mapping[str, Fault], judge: Judge, folder: Path, *, seed: int,
        progress: Callable[[str], None] = lambda what: None) -> Result:
    """Check everything clean, then every fault.

    A fault is caught by a check that is meant for it and raises an error on every file that it was planted in, and
    no error on the file without it.

    Args:
        material: what is clean.
        faults: what is planted.
        judge: the checks.
        folder: where planted files are written.
        seed: decides where and how large faults are.
        progress: called with what is looked at next, once for each kind of clean material and each fault.
    """
    before: dict[Path, Seen] = {}
    alarms: list[Alarm] = []
    for kind, paths in material.clean.items():
        progress(f"clean: {kind}")
        seen = judge(paths, material.contracts[kind])
        before |= zip(paths, seen, strict=True)
        alarms += [Alarm(path, _first(s)) for path, s in zip(paths, seen, strict=True) if s.errors or s.refused]
    progress("clean, without a contract")
    everything = [path for paths in material.clean.values() for path in paths]
    alarms += [Alarm(path, _first(s)) for path, s in zip(everything, judge(everything, Contract()), strict=True)
               if s.errors or s.refused]
    planted: list[Planted] = []
    for name, fault in faults.items():
        progress(name)
        sites = list(_sites(name, fault, material, folder, seed))
        for site in sites:
            fault.plant(site)
        planted.append(_judged(name, fault, sites, judge, material.contracts[fault.on], before))
    datasets = sum(len(p) for kind, p in material.clean.items() if "dataset" in kind)
    return Result(tuple(planted), material.episodes, datasets, material.rendered, tuple(alarms))


def _sites(name: str, fault: Fault, material: Material, folder: Path, seed: int) -> Iterator[Site]:
    """Where a fault is planted: up to PLANTS pieces of clean material, each with a generator of its own."""
    rng = np.random.default_rng([seed, int(short_id("fault", name), 16)])
    clean = material.clean[fault.on]
    (folder / name).mkdir(parents=True)
    for k, place in enumerate(rng.permutation(len(clean))[:PLANTS]):
        source = clean[int(place)]
        yield Site(source, folder / name / f"{k}{source.suffix}", np.random.default_rng(rng.integers(1 << 62)))


def _judged(name: str, fault: Fault, sites: list[Site], judge: Judge, contract: Contract,
            before: Mapping[Path, Seen]) -> Planted:
    each: list[set[str]] = []
    said, instead = "", ""
    for site in sites:
        seen = judge([site.clean, site.out] if fault.beside else [site.out], contract)[-1]
        known = {f.check for f in before[site.clean].errors}
        new = [f for f in seen.errors if f.check not in known]
        each.append({f.check for f in new} | ({REFUSED} if seen.refused else set()))
        said = said or next((f.line() for f in new if f.check in fault.expect), seen.refused)
        if not each[-1] & set(fault.expect):
            instead = f"{site.clean.name}: {_first(seen) or 'nothing was found'}"
    caught = tuple(check for check in fault.expect if all(check in found for found in each))
    if not caught and not instead:
        caught = tuple(check for check in fault.expect if any(check in found for found in each))
    others = sorted({check for found in each for check in found} - set(fault.expect))
    return Planted(name, fault, tuple(s.out for s in sites), caught, tuple(others), said if caught else instead)


def _first(seen: Seen) -> str:
    return seen.refused or next((f.line() for f in seen.errors), "")
