"""hardcase check: find what is named, check it, note the verdicts, and say what was found."""

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from pipeline.check.contract import load_contract
from pipeline.check.initial import to_yaml
from pipeline.errors import ConfigError, StoreError
from pipeline.files import atomic
from pipeline.lerobot_view.incomplete import refuse_starts
from pipeline.store import Store, store_root
from schemas.contract import Contract
from schemas.episode import VARIANTS, Episode
from schemas.finding import CheckVerdict, Finding
from stages.check import Checked, Item, check, init

PASSED, FAILED, UNREADABLE = 0, 1, 2
ID = re.compile(r"[0-9a-f]{8,16}")
TEACHING = ("finite", "units", "lag", "answer", "success-flag")
"""Checks that every build makes of what is new: faults that teach something wrong. What only looks odd, such as uneven
stamps of a live recording, is for people to judge: hardcase check."""
SHOWN = 5
"""Findings of one check that are printed of one item."""


def check_all(names: Sequence[str], *, contract: Path | None, out: Path | None) -> tuple[str, int]:
    """Check recordings and datasets, by path or by id.

    Args:
        names: .mcap files, folders of datasets, ids of episodes and versions.
        contract: YAML file; without one only what speaks for itself is checked.
        out: where to write everything as JSON.

    Returns:
        What to print, and the exit code: 0 passed, 1 something is wrong, 2 something cannot be read.

    Raises:
        HardcaseError: the contract or the store cannot be used, or an id is not known.
    """
    rules = load_contract(contract) if contract else Contract()
    done = check([_item(name) for name in names], rules)
    _remember([c.verdict for c in done if c.verdict is not None])
    if out is not None:
        with atomic(out) as stream:
            stream.write((json.dumps(_as_json(done), indent=1, ensure_ascii=False) + "\n").encode())
    return "\n".join(_told(done)), _code(done)


def look_at_new(store: Store, episodes: Iterable[Episode], known: Collection[str]) -> None:
    """Check recordings of our own that nobody has checked, and note the verdicts: what fails does not teach.

    Args:
        store: holds the recordings.
        episodes: what is about to teach; variants and what came from foreign logs are passed over.
        known: sha256 of recordings that have a verdict; a person's own, with a contract, is not overruled.
    """
    new = {e.blob: e for e in episodes if e.blob and e.blob not in known and e.origin not in VARIANTS
           and store.log_of(e) is None}
    items = [Item(store.blob(blob), e.id, trusted=True) for blob, e in new.items()]
    for done in check(items, Contract(), names=TEACHING):
        if done.verdict is not None:
            store.add_check(done.verdict)


def write_contract(names: Sequence[str]) -> str:
    """A contract from good logs, as YAML.

    Raises:
        HardcaseError: a log cannot be read, or is not good.
    """
    items = [_item(name) for name in names]
    for checked in check(items, Contract()):
        if checked.error is not None:
            raise checked.error
        if checked.verdict is not None and not checked.verdict.passed:
            raise ConfigError(f"not a good log: {checked.verdict.reason}", where=checked.item.name,
                              mend=f"write the contract from a log that passes: hardcase check {checked.item.name}")
    return to_yaml(init(items))


def _item(name: str) -> Item:
    path = Path(name)
    if path.exists() or not ID.fullmatch(name):
        return Item(path, path.name or path.resolve().name)
    with Store.open(store_root()) as store:
        table, id = store.find(name)
        if table == "version":
            refuse_starts(store.path(store.version(id).path))
            return Item(store.path(store.version(id).path), id, trusted=True)
        if table != "episode":
            raise StoreError(f"{table.replace('_', ' ')} {id} is no recording and no dataset",
                             where=f"hardcase check {name}", mend="name an episode or a dataset version")
        episode = store.episode(id)
        if episode.blob is None or episode.origin in VARIANTS:
            raise StoreError(f"episode {id} is a variant and has no recording of its own",
                             where=f"hardcase check {name}",
                             mend=f"check what it was made from ({episode.parent}), or its dataset version")
        if (log := store.log_of(episode)) is not None:  # its frames were made of a foreign log, which is what is judged
            return Item(store.blob(log), id)
        return Item(store.blob(episode.blob), id, trusted=True)


def _remember(verdicts: Sequence[CheckVerdict]) -> None:
    """Note verdicts in the store, if there is one; of byte-identical files the first one's."""
    if not (store_root() / "catalog.db").is_file():
        return
    first = {v.subject: v for v in reversed(verdicts)}
    with Store.open(store_root()) as store:
        for verdict in first.values():
            store.add_check(verdict)


def _code(done: Sequence[Checked]) -> int:
    if any(c.error is not None for c in done):
        return UNREADABLE
    return PASSED if all(c.verdict is not None and c.verdict.passed for c in done) else FAILED


def _as_json(done: Sequence[Checked]) -> dict[str, Any]:
    items: list[dict[str, Any]] = []
    for checked in done:
        if checked.error is not None:
            error = {"what": checked.error.what, "where": checked.error.where, "mend": checked.error.mend}
            items.append({"name": checked.item.name, "passed": False, "error": error})
        elif checked.verdict is not None:
            items.append(checked.verdict.model_dump(mode="json"))
    return {"passed": _code(done) == PASSED, "items": items}


def _told(done: Sequence[Checked]) -> list[str]:
    """A line for each item, one for each finding, then what to do."""
    lines: list[str] = []
    mends: dict[str, None] = {}
    for checked in done:
        if checked.error is not None:
            lines.append(f"{checked.item.name}: cannot be read: {checked.error.what}")
            mends[f"{checked.item.name}: {checked.error.mend}"] = None
            continue
        if (verdict := checked.verdict) is None:
            continue
        result = "passed" if verdict.passed else "FAILED"
        lines.append(f"{checked.item.name}: {result}, {len(verdict.checks)} checks"
                     + (f" ({len(verdict.skipped)} had nothing to look at)" if verdict.skipped else ""))
        lines += _table(verdict.findings)
        mends |= dict.fromkeys(f"{f.check}: {f.mend}" for f in verdict.findings)
    if len(done) > 1:
        failed = sum(c.verdict is None or not c.verdict.passed for c in done)
        lines.append(f"{len(done) - failed} of {len(done)} passed")
    return lines + [f"mend {mend}" for mend in mends]


def _table(findings: Sequence[Finding]) -> list[str]:
    count = Counter(f.check for f in findings)
    shown = Counter[str]()
    rows: list[tuple[str, str, str, str]] = []
    for finding in findings:
        shown[finding.check] += 1
        if shown[finding.check] <= SHOWN:
            rows.append((finding.severity, finding.check, finding.place(), finding.what))
        elif shown[finding.check] == count[finding.check]:
            rows.append(("", finding.check, f"and {count[finding.check] - SHOWN} more", "--json OUT lists them"))
    widths = [max((len(row[k]) for row in rows), default=0) for k in range(3)]
    cells = ((*(c.ljust(w) for c, w in zip(row[:3], widths, strict=True)), row[3]) for row in rows)
    return ["  " + "  ".join(line) for line in cells]
