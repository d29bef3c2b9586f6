"""Referees: checkers of recordings that others wrote, asked about the same files through their own commands."""

import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import yaml

from pipeline.selftest.judging import Planted
from pipeline.selftest.log import Log
from pipeline.selftest.material import Kind, Material
from pipeline.selftest.opinions import Asked, Opinion

RATE_OFF = 0.1
"""Share that a topic's rate may be off."""
GAP_S = 0.25
"""Longest silence of a steady topic [s]; as in schemas.contract.Thresholds."""
STEADY = 16
"""Messages from which on a topic is held to a rate."""
TIMEOUT_S = 60.0
PASSED, FOUND = 0, 1


@dataclass(frozen=True, slots=True)
class Expected:
    """What a good recording holds, as referees are told."""

    profile: str
    topics: Mapping[str, tuple[str, float | None]]
    """Topic -> its type and, where it is steady, its rate [Hz]."""
    stamped: frozenset[str]
    """Topics whose messages carry a header."""

    @classmethod
    def of(cls, good: Path) -> "Expected":
        """What this recording holds."""
        log = Log.read(good)
        topics: dict[str, tuple[str, float | None]] = {}
        stamped = set[str]()
        for channel in log.channels.values():
            messages = log.of(channel.topic)
            span_s = (messages[-1].log_time - messages[0].log_time) / 1e9 if messages else 0.0
            steady = len(messages) >= STEADY and span_s > 0.8 * log.span_s
            topics[channel.topic] = (log.schemas[channel.schema_id].name,
                                     (len(messages) - 1) / span_s if steady else None)
            if messages and log.has_header(messages[0]):
                stamped.add(channel.topic)
        return cls(log.profile, topics, frozenset(stamped))


def tracecheck_contract(expected: Expected) -> dict[str, Any]:
    """A contract for `tracecheck check`: without clock_confirmed, rate and gap it would skip its timing checks."""
    topics: dict[str, dict[str, Any]] = {}
    for name, (kind, rate_hz) in expected.topics.items():
        topics[name] = {"required": rate_hz is not None, "message_encoding": "cdr", "schema_name": kind,
                        "schema_encoding": "ros2msg"}
        if rate_hz is not None:
            topics[name] |= {
                "min_count": STEADY,
                "clock_confirmed": True, "time_basis": "log_time", "check_regression": True,
                "min_rate_hz": rate_hz * (1 - RATE_OFF), "max_rate_hz": rate_hz * (1 + RATE_OFF),
                "max_gap_ns": int(GAP_S * 1e9), "sequence": "increment_mod32"}
    record = {"robot": "arm", "task": "pick-place", "control_hz": "20.0", "outcome": None, "consent": None}
    return {"version": 1, "name": "hardcase selftest", "profile": expected.profile, "metadata": {"episode": record},
            "topics": topics}


def baglint_spec(expected: Expected) -> dict[str, Any]:
    """A spec for `baglint --strict`; stamps are looked at wherever there are any."""
    topics: dict[str, dict[str, Any]] = {}
    for name, (_, rate_hz) in expected.topics.items():
        topics[name] = {"required": rate_hz is not None, "check_stamps": name in expected.stamped}
        if rate_hz is not None:
            topics[name] |= {"min_rate": rate_hz * (1 - RATE_OFF), "max_gap_ms": GAP_S * 1e3}
    return {"topics": topics, "transforms": {"required": [["world", "object"]]}}


def ask_tracecheck(recording: Path, expected: Expected) -> Opinion:
    """`tracecheck check RECORDING --contract CONTRACT.json --out NEW_FOLDER`."""
    with TemporaryDirectory() as folder:
        contract, out = Path(folder) / "contract.json", Path(folder) / "out"
        contract.write_text(json.dumps(tracecheck_contract(expected)))
        done = _run("tracecheck", "check", recording, "--contract", contract, "--out", out, "--quiet")
        if done.returncode not in (PASSED, FOUND):
            return Opinion(False, ("refused",))
        report = json.loads((out / "report.json").read_text())
        bad = tuple(f"{c['id']} {c['name']}" for c in report["checks"] if c["status"] in ("fail", "warn"))
        return Opinion(done.returncode == PASSED, bad)


def ask_baglint(recording: Path, expected: Expected) -> Opinion:
    """`baglint RECORDING --spec SPEC.yaml --strict --format json`."""
    with TemporaryDirectory() as folder:
        spec = Path(folder) / "spec.yaml"
        spec.write_text(yaml.safe_dump(baglint_spec(expected)))
        done = _run("baglint.cli", recording, "--spec", spec, "--strict", "--format", "json")
        if done.returncode not in (PASSED, FOUND):
            return Opinion(False, ("refused",))
        codes = [f["code"] for f in json.loads(done.stdout)["findings"] if f["level"] != "INFO"]
        return Opinion(done.returncode == PASSED, tuple(dict.fromkeys(codes)))


REFEREES = MappingProxyType({"tracecheck": ask_tracecheck, "baglint": ask_baglint})
"""Name, which is also the package's, -> how it is asked."""


CLEAN_EACH = 2
"""Clean recordings of each kind that referees are asked about."""


def ask_referees(material: Material, planted: Sequence[Planted], progress: Callable[[str], None]) -> Asked:
    """Ask every referee about every planted recording and about clean ones of each kind."""
    kinds: list[Kind] = [kind for kind in material.clean if "dataset" not in kind]
    expected = {kind: Expected.of(material.clean[kind][0]) for kind in kinds}
    clean = {path: _opinions(path, expected[kind]) for kind in kinds for path in material.clean[kind][:CLEAN_EACH]}
    found: dict[str, dict[str, Opinion]] = {}
    for fault in planted:
        if fault.fault.on in kinds:
            progress(f"referees: {fault.name}")
            found[fault.name] = _opinions(fault.files[0], expected[fault.fault.on])
    return Asked(found, tuple(
        f"{referee} on {path.parent.name}/{path.name}: {', '.join(opinion.reasons)}"
        for path, opinions in clean.items() for referee, opinion in opinions.items() if not opinion.passed))


def _opinions(path: Path, expected: Expected) -> dict[str, Opinion]:
    return {name: ask(path, expected) for name, ask in REFEREES.items()}


def _run(module: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, "-m", module, *map(str, arguments)], capture_output=True, text=True,
                          timeout=TIMEOUT_S, check=False)
