"""`hardcase rl report`: the page of one or several trainings."""

import json as jsonlib
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from flows.rl.evaluations import kept_evaluation
from flows.rl.training import BASELINES, POLICY
from pipeline.errors import unknown
from pipeline.files import atomic, sha256_file, short_id
from pipeline.ppo.record import TrainingRecord, read_record
from pipeline.report.trainings import Pooled, ShownTraining, grouped, trainings_page
from pipeline.statistics import Interval, bootstrap_difference
from pipeline.store import store_root


def run_report(folders: Sequence[Path], out: Path | None, *, attempts: int, seed: int, strata: Sequence[str],
               threads: int, as_json: bool) -> str:
    """Write the page, evaluating what is not evaluated yet, and say what to print.

    Args:
        folders: of `hardcase rl train`.
        out: the page; reports/rl-ID.html in the store where None.
        attempts, seed: of the evaluations; 0 attempts: none.
        strata: kinds of start; the one that was trained on and the task's first where empty.
        threads: threads of the engine.
        as_json: whether machines read what is printed.

    Raises:
        HardcaseError: a folder without a training, or with a damaged one.
    """
    folders = list(dict.fromkeys(folder.resolve() for folder in folders))
    records = [read_record(folder) for folder in folders]
    for record in records:
        for kind in set(strata) - set(record.order.task.starts):
            raise unknown("stratum", kind, record.order.task.starts)
    names = named(records, folders)
    console, shown = Console(stderr=True), list[ShownTraining]()
    for folder, record, (group, name) in zip(folders, records, names, strict=True):
        policy = sha256_file(folder / POLICY) if (folder / POLICY).is_file() else None
        evaluations: list[dict[str, Any]] = []
        for kind in _kinds(record, strata) if policy and attempts else ():
            with console.status(f"{group}, {name}: {kind} starts"):
                evaluations.append(kept_evaluation(folder, attempts=attempts, seed=seed, stratum=kind, threads=threads))
        shown.append(ShownTraining(group, name, record, folder.name, policy, tuple(evaluations)))
    shown.sort(key=lambda one: [group for group, _ in names].index(one.group))
    command = shlex.join(["hardcase", "rl", "report", *(str(folder) for folder in folders)])
    page = out or store_root() / "reports" / f"rl-{short_id(*(record.id for record in records))}.html"
    over = pooled(shown)
    with atomic(page) as stream:
        stream.write(trainings_page(shown, over, command=command, notes=_notes(shown)).encode())
    if as_json:
        return jsonlib.dumps({"page": str(page), "trainings": [_told(one) for one in shown], "pooled": [
            {"group": p.group, "stratum": p.stratum, "seeds": p.seeds, "policy": _bounds(p.policy),
             "ahead": _bounds(p.ahead)} for p in over]})
    return "\n".join([*(_line(one) for one in shown), str(page)])


def named(records: Sequence[TrainingRecord], folders: Sequence[Path]) -> list[tuple[str, str]]:
    """Group and name of each training; two of one seed are told apart by their folders."""
    groups = grouped([record.order for record in records])
    names = [(group, f"seed {record.order.seed}") for group, record in zip(groups, records, strict=True)]
    return [(group, name if names.count((group, name)) == 1 else f"{name} in {folder.parent.name}/{folder.name}")
            for (group, name), folder in zip(names, folders, strict=True)]


def pooled(shown: Sequence[ShownTraining]) -> list[Pooled]:
    """Groups of several evaluated seeds, by kind of start: rate, and distance to zero action on the same starts."""
    found: list[Pooled] = []
    for group in dict.fromkeys(one.group for one in shown):
        members = [one for one in shown if one.group == group and one.evaluations]
        kinds = dict.fromkeys(e["stratum"] for one in members for e in one.evaluations)
        for kind in kinds if len(members) > 1 else ():
            bits = [e["outcomes"] for one in members for e in one.evaluations if e["stratum"] == kind]
            policy, zero = (np.array([[bit == "1" for bit in one[arm]] for one in bits]) for arm in
                            ("policy", BASELINES[0]))
            found.append(Pooled(group, kind, len(bits), _apart(policy, np.zeros_like(policy)), _apart(policy, zero)))
    return found


def _apart(first: Any, second: Any) -> Interval:
    return bootstrap_difference({"all": (first, second)}, {"all": 1.0}, np.random.default_rng(0))


def _kinds(record: TrainingRecord, strata: Sequence[str]) -> list[str]:
    """Kinds of start that are judged: the trained one comes first."""
    first = next(iter(record.order.task.starts))
    return list(dict.fromkeys(strata)) or list(dict.fromkeys([record.order.stratum or first, first]))


def _notes(shown: Sequence[ShownTraining]) -> list[str]:
    return [f"{one.group}, {one.name} is not over: {one.record.steps:,} of {one.record.order.ppo.steps:,} steps."
            for one in shown if not one.record.over] + [
        f"{one.group}, {one.name}: the id {one.record.id} does not follow from its order; it was trained by another "
        "version, or its record was changed." for one in shown if one.record.id != one.record.order.id] + [
        f"{one.group}, {one.name}: policy.onnx says that it is of training {said}." for one in shown
        if (said := next((e["training"] for e in one.evaluations), one.record.id)) != one.record.id]


def _told(one: ShownTraining) -> dict[str, Any]:
    record = one.record
    return {"group": one.group, "name": one.name, "folder": one.folder, "order": record.id, "steps": record.steps,
            "over": record.over, "cpu_s": record.cpu_s, "policy_sha256": one.policy, "last": dict(record.curve[-1]),
            "evaluations": [{k: v for k, v in e.items() if k != "outcomes"} for e in one.evaluations]}


def _bounds(found: Interval) -> dict[str, float]:
    return {"estimate": found.estimate, "low": found.low, "high": found.high}


def _line(one: ShownTraining) -> str:
    said = ", ".join(f"{e['arms']['policy']['rate']:.3f} [{e['arms']['policy']['low']:.3f} "
                     f"{e['arms']['policy']['high']:.3f}] of {e['stratum']} starts" for e in one.evaluations)
    return f"{one.group}, {one.name}: {one.record.steps:,} steps; {said or 'not evaluated'}"
