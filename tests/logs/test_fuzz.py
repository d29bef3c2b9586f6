"""Files that were damaged or forged, each read in a limited child: no hang, no crash, and no silent difference.

500 of them here; more by their number: HARDCASE_FUZZ=10000 .venv/bin/python -m pytest -s tests/logs/test_fuzz.py
"""

import hashlib
import io
import os
import struct
import time
from collections import Counter
from importlib.util import module_from_spec, spec_from_file_location
from itertools import batched
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from pipeline.errors import HardcaseError, RecordingError
from pipeline.logs.child import Children
from pipeline.logs.fingerprint import fingerprint_here
from pipeline.logs.stream import open_log

NUMBER = int(os.environ.get("HARDCASE_FUZZ", "500"))
pytestmark = pytest.mark.timeout(300 + NUMBER)


def sibling(name: str) -> ModuleType:
    spec = spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def by_the_library(data: bytes) -> dict[str, tuple[int, str]] | None:
    """Channel -> messages and their hash, as the mcap library's stream reader finds them; None where it refuses."""
    counts, digests = Counter(), dict[str, Any]()
    try:
        for record in StreamReader(io.BytesIO(data), validate_crcs=True, record_size_limit=1 << 26).records:
            if isinstance(record, Channel):
                digests.setdefault(str(record.id), hashlib.sha256())
            if isinstance(record, Message):
                digest = digests[str(record.channel_id)]
                counts[str(record.channel_id)] += 1
                digest.update(struct.pack("<QQIQ", record.log_time, record.publish_time, record.sequence,
                                          len(record.data)) + record.data)
    except Exception:
        return None
    return {number: (counts[number], digest.hexdigest()) for number, digest in digests.items()}


def prefixes(path: Path) -> dict[str, list[str]]:
    """Channel -> hash of its first 0, 1, 2, ... messages."""
    found: dict[str, list[str]] = {}
    digests: dict[str, Any] = {}
    with open_log(path) as log:
        for batch in log.batches():
            number = str(batch.channel.number)
            digest = digests.setdefault(number, hashlib.sha256())
            hashes = found.setdefault(number, [digest.hexdigest()])
            for k in range(len(batch)):
                payload = batch.payload(k)
                digest.update(struct.pack("<QQIQ", batch.log_ns[k], batch.publish_ns[k], batch.sequence[k],
                                          len(payload)) + payload)
                hashes.append(digest.hexdigest())
    return found


def messages(found: dict) -> dict[str, tuple[int, str]]:
    return {n: (c["messages"], c["sha256"]) for n, c in found["channels"].items()}


def judge(found: object, original: dict, mutant) -> str:
    """What came of a mutant, in a word; the test fails on the last two."""
    if isinstance(found, HardcaseError):
        good = isinstance(found, RecordingError) and found.mend and "\n" not in found.what
        return "refused" if good else "BAD ERROR"
    told = [p for p in found["problems"] if p not in original["problems"]]
    if {**found, "problems": 0} == {**original, "problems": 0}:
        return "same, a problem told" if told else "same"
    if told:
        return "differs, a problem told"
    if mutant.forged:
        agreed = by_the_library(mutant.data) == messages(found)
        return "forged, as the library reads it" if agreed else "SILENT DIFFERENCE"
    unproven = " ".join(what for what, _ in original["problems"])
    moved = messages(found) != messages(original)
    if ("messages or attachments without" if moved else "metadata or channels without") in unproven:
        return "differs, no CRC in the file (told)"
    return "SILENT DIFFERENCE"


def test_mutants_are_refused_told_or_the_same(tmp_path):
    seeds, mutants = sibling("fuzz_seeds"), sibling("fuzz_mutants")
    table, slowest, wrong = Counter[tuple[str, str]](), (0.0, ""), list[str]()
    with Children(1) as children:
        originals, names = dict[str, tuple[bytes, dict]](), list[str]()
        for name, data in seeds.seeds(tmp_path).items():
            (tmp_path / "seed").write_bytes(data)
            originals[name] = data, children.call(fingerprint_here, str(tmp_path / "seed"), where=tmp_path / "seed")
        names = list(originals)
        for numbers in batched(range(NUMBER), 50):
            made = {}
            for number in numbers:
                data, original = originals[names[number % len(names)]]
                made[tmp_path / str(number)] = mutants.mutant(data, np.random.default_rng([7, number])), original
            for path, (mutant, _) in made.items():
                path.write_bytes(mutant.data)
            start = time.monotonic()
            for (path, (mutant, original)), found in zip(made.items(), children.map(fingerprint_here, list(made)),
                                                         strict=True):
                slowest = max(slowest, (time.monotonic() - start, f"{path.name} {mutant.kind}"))
                start = time.monotonic()
                verdict = judge(found, original, mutant)
                table[mutant.kind.split(":")[0], verdict] += 1
                if verdict.isupper():
                    wrong.append(f"{path.name} {names[int(path.name) % len(names)]}, {mutant.kind}: {verdict} {found}")
                path.unlink()
    verdicts = sorted({v for _, v in table})
    print("\n| mutant | " + " | ".join(verdicts) + " |\n" + "|---" * (len(verdicts) + 1) + "|")
    for kind in sorted({k for k, _ in table}):
        print(f"| {kind} | " + " | ".join(str(table[kind, v] or "") for v in verdicts) + " |")
    print(f"slowest: {slowest[0]:.2f} s, {slowest[1]}")
    assert not wrong, "\n".join(wrong[:10])
    assert slowest[0] < 20, "limits are seconds of CPU time, and the machine may be busy"
    for seen in ("refused", "same", "same, a problem told"):
        assert sum(n for (_, v), n in table.items() if v == seen) > NUMBER // 50


def test_what_is_kept_of_a_damaged_file_is_how_it_began(tmp_path):
    seeds, mutants = sibling("fuzz_seeds"), sibling("fuzz_mutants")
    kept = 0
    with Children(1) as children:
        for name, data in seeds.seeds(tmp_path).items():
            (tmp_path / "seed").write_bytes(data)
            began = prefixes(tmp_path / "seed")
            paths = [tmp_path / f"{name} {number}" for number in range(NUMBER // 40)]
            for number, path in enumerate(paths):
                path.write_bytes(mutants.raw(data, np.random.default_rng([11, number])).data)
            for path, found in zip(paths, children.map(fingerprint_here, paths, True), strict=True):
                if isinstance(found, HardcaseError) or any("messages or" in what for what, _ in found["problems"]):
                    continue  # refused, or said to hold messages that no CRC covers
                for number, (count, digest) in messages(found).items():
                    assert count == 0 or began[number][count] == digest, (path, found["problems"])
                kept += any(kind == "damage" for _, kind in found["problems"])
    assert kept > NUMBER // 20
