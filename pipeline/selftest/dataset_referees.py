"""Referees of datasets: checkers that others wrote, and lerobot itself, asked about folders through their own commands.

What each looks at, by its source: lerobot 0.6.1 opens a folder and gives every sample, pictures decoded. robovet 0.2.2
compares tables, rows, statistics and packets. lerobot-doctor 0.2.0 looks at the values of rows, at lengths and at what
policies want. rdq 0.3.4 scores counts, times, statistics, duplicates, idleness, jumps and, asked so, every picture.
kalanos 0.8.2 grades the values of each channel and, by its profile for vision, every picture.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import NamedTuple

from pipeline.arrow import read_parquet
from pipeline.lerobot_view.layout import EPISODES, INFO
from pipeline.selftest.asking import Answer
from pipeline.selftest.judging import Planted
from pipeline.selftest.material import REFUSED, Material
from pipeline.selftest.opinions import Asked, Opinion

TIMEOUT_S = 1800.0
LONG = 200
"""Characters of a remark that are kept."""
RDQ_LEAST = 95
"""Score of rdq below which a dataset fails."""


class Referee(NamedTuple):
    """One checker of datasets."""

    package: str
    """What must be importable."""
    command: str
    """MODULE:FUNCTION that its console script calls."""
    arguments: Callable[[Path, Path], list[str]]
    """A dataset and a place for a report -> the words of the command line."""
    opinion: Callable[[Answer, Path], Opinion]
    """What it said and where its report would be -> what it means."""
    expected: Mapping[str, str]
    """Patterns of remarks on good data that it makes and that do not fail it -> why they name no fault of the data."""


def _lerobot(told: Answer, report: Path) -> Opinion:
    if told.code not in (0, 1):
        return _refused(told)
    return Opinion(told.code == 0, tuple(_short(text) for text in json.loads(told.out)))


def _robovet(told: Answer, report: Path) -> Opinion:
    if not report.is_file():
        return _refused(told)
    results = [(r["severity"], _short(f"{r['check_id']} {r['summary']}"))
               for r in json.loads(report.read_text())["results"]]
    return _opinion(told, results, fails=("FAIL",), remarks=("WARN", "INFO"))


def _lerobot_doctor(told: Answer, report: Path) -> Opinion:
    if not told.out.startswith("{"):
        return _refused(told)
    results = [(m["severity"], _short(f"{_slug(check['name'])} {m['message']}"))
               for check in json.loads(told.out)["checks"] for m in check["messages"]]
    return _opinion(told, results, fails=("FAIL",), remarks=("WARN",))


def _rdq(told: Answer, report: Path) -> Opinion:
    if not report.is_file():
        return _refused(told)
    found = json.loads(report.read_text())
    results = [(f["severity"], _short(f"{f['check']} {f['message']}")) for f in found["findings"]]
    fails = ("critical", "warning") if told.code else ()
    return _opinion(told, results, fails=fails, remarks=("critical", "warning", "info"))


def _kalanos(told: Answer, report: Path) -> Opinion:
    if not told.out.startswith("{"):
        return _refused(told)
    found = json.loads(told.out)
    results = [(reason["status"], _short(_metric_first(str(reason["id"]))))
               for episode in found["episodes"] for reason in episode["eligibility"]["reasons"]]
    results += [("review", "duplicates") for _ in found["duplicates"]]
    results += [("blocked", "incomplete") for _ in range(not found["inventory"]["complete"])]
    return _opinion(told, results, fails=("blocked", "unknown"), remarks=("review",))


def _opinion(told: Answer, results: Iterable[tuple[str, str]], *, fails: Collection[str],
             remarks: Collection[str]) -> Opinion:
    each = list(dict.fromkeys(results))
    return Opinion(told.code == 0, tuple(text for status, text in each if status in fails),
                   tuple(text for status, text in each if status in remarks and status not in fails))


def _refused(told: Answer) -> Opinion:
    last = (told.err or told.out).strip().splitlines() or [""]
    return Opinion(False, (_short(f"{REFUSED} {last[-1]}"),))


def _short(text: str) -> str:
    """One line in which numbers are told as #, so that the same remark on other data is the same text."""
    code, _, rest = " ".join(text.split()).partition(" ")
    return f"{code} {re.sub(r'[0-9]+([.][0-9]+)?(e[+-]?[0-9]+)?', '#', rest)}".strip()[:LONG]


def _slug(name: str) -> str:
    return "-".join(re.findall(r"[a-z]+", name.lower()))


def _metric_first(id: str) -> str:
    """STREAM/CHANNEL.FAMILY.METRIC with the metric first."""
    parts = id.rsplit(".", 2)
    return f"{'.'.join(parts[1:])} {parts[0]}" if len(parts) == 3 else id


STILL = "the hand waits while the finger closes, and no task needs every axis"
GRIPPER = "a gripper is open or shut most of the time"
NOT_USED = "a mark lies on the table, and nobody intervenes in a demonstration"
WHOLE = "it says what the robot did and which policies would like more, not that the record is wrong"
PART = "a trim addresses a part of its parent's video; it counts whole files, and does not read from_timestamp"
STEPS = "actions are steps of the hand, the state has joints as well"
CORRECTED = "a correction holds an attempt that failed, then what a person did: it is longer, the gripper opens again"


def _to_lerobot(folder: Path, report: Path) -> list[str]:
    return [str(folder)]


def _to_robovet(folder: Path, report: Path) -> list[str]:
    return ["doctor", str(folder), "--json", str(report)]


def _to_lerobot_doctor(folder: Path, report: Path) -> list[str]:
    return ["check", str(folder), "--ci"]


def _to_rdq(folder: Path, report: Path) -> list[str]:
    words = ["check", str(folder), "--fail-under", str(RDQ_LEAST), "--json", str(report)]
    if taken_over := _taken_over(folder):  # rdq lets an owner name the episodes that are unusual on purpose
        path = report.with_suffix(".expected.json")
        path.write_text(json.dumps([{"episodes": taken_over, "checks": ["episodes.*"], "reason": CORRECTED}]))
        words += ["--expected", str(path)]
    return [*words, "--video-full"] if _has_videos(folder) else words


def _to_kalanos(folder: Path, report: Path) -> list[str]:
    words = ["grade", str(folder), "--json"]
    return [*words, "--profile", "vision-imitation-v1", "--tier", "full"] if _has_videos(folder) else words


def _taken_over(folder: Path) -> list[int]:
    """Episodes in which somebody took over from a policy."""
    table = read_parquet(folder / EPISODES)
    segments: list[str | None] = table.column("segments").to_pylist() if "segments" in table.column_names else []
    return [k for k, text in enumerate(segments) if text and '"intervention"' in text]


def _has_videos(folder: Path) -> bool:
    features = json.loads((folder / INFO).read_text(encoding="utf-8"))["features"]
    return any(feature["dtype"] == "video" for feature in features.values())


DATASET_REFEREES: MappingProxyType[str, Referee] = MappingProxyType({
    "lerobot": Referee("lerobot", "pipeline.selftest.with_lerobot:main", _to_lerobot, _lerobot, {}),
    "robovet": Referee("robovet", "robovet.cli:app", _to_robovet, _robovet,
                       {"DATA-108 *dimension(s) never change*": NOT_USED,
                        "VIDEO-403 *LeRobot's own default recording codec*": "the same codec as lerobot's default"}),
    "lerobot-doctor": Referee(
        "lerobot_doctor", "lerobot_doctor.cli:main", _to_lerobot_doctor, _lerobot_doctor,
        {"action-quality *of values at m*": GRIPPER, "action-quality *frozen*": STILL, "per-episode-summary *": STILL,
         "data-distribution * zero variance*": NOT_USED, "anomaly-detection *constant*": NOT_USED,
         "anomaly-detection *stuck/static*": GRIPPER, "anomaly-detection *distribution shift*": WHOLE,
         "episode-health *shorter than chunk_size*": WHOLE, "training-readiness *": WHOLE,
         "video-integrity * has # frames, expected # from # episode(s)": PART}),
    "rdq": Referee("rdq", "rdq.cli:main", _to_rdq, _rdq,
                   {"schema.action_state_dims_differ *": STEPS, "episodes.trajectory_outlier *": WHOLE,
                    "episodes.too_long *": WHOLE, "episodes.* Expected by the dataset's owner*": CORRECTED}),
    "kalanos": Referee("kalanos", "kalanos.cli:app", _to_kalanos, _kalanos,
                       {"integrity.flatline_pct *.observation.state/cmd_*": STILL}),
})
"""Name -> how it is asked, what its answer means, and what it is known to say of good data."""


def ask_about(folders: Sequence[Path], names: Collection[str] = DATASET_REFEREES.keys()) -> dict[
        Path, dict[str, Opinion]]:
    """Ask referees about datasets; each gets one process in which its command is called once a dataset.

    Args:
        folders: LeRobot datasets.
        names: the referees that are asked; all of them by default.

    Returns:
        Dataset -> referee -> what it says.
    """
    opinions: dict[Path, dict[str, Opinion]] = {folder: {} for folder in folders}
    with TemporaryDirectory(prefix="hardcase-referees-") as aside:
        for name in names:
            referee = DATASET_REFEREES[name]
            reports = [Path(aside) / f"{name}-{k}.json" for k in range(len(folders))]
            calls = [referee.arguments(folder, report) for folder, report in zip(folders, reports, strict=True)]
            for folder, report, told in zip(folders, reports, _answers(referee.command, calls, aside), strict=True):
                opinions[folder][name] = referee.opinion(told, report)
    return opinions


def _answers(command: str, calls: list[list[str]], aside: str) -> list[Answer]:
    """What the command says to each call; its caches stay aside, and no network is asked."""
    own = {"HF_HUB_OFFLINE": "1", "HF_HOME": aside, "HF_LEROBOT_HOME": aside, "HF_DATASETS_CACHE": aside,
           "OMP_NUM_THREADS": "1", "NO_COLOR": "1"}
    done = subprocess.run([sys.executable, "-m", "pipeline.selftest.asking", command], input=json.dumps(calls),
                          capture_output=True, text=True, timeout=TIMEOUT_S, check=True, env={**os.environ, **own})
    return [Answer(*told) for told in json.loads(done.stdout)]


def unexpected(name: str, opinion: Opinion) -> list[str]:
    """What a referee says of good data beyond what it is known to say of it."""
    known = DATASET_REFEREES[name].expected
    fails = list(opinion.reasons) or ([] if opinion.passed else ["failed without a reason"])
    return [*fails, *(text for text in opinion.remarks if not any(fnmatchcase(text, p) for p in known))]


def news(opinion: Opinion, clean: Iterable[Opinion]) -> Opinion:
    """What a referee says of a planted dataset that it does not say of the clean ones."""
    before = {text for one in clean for text in (*one.reasons, *one.remarks)}
    return Opinion(opinion.passed, tuple(t for t in opinion.reasons if t not in before),
                   tuple(t for t in opinion.remarks if t not in before))


def ask_dataset_referees(material: Material, planted: Sequence[Planted], progress: Callable[[str], None]) -> Asked:
    """Ask every referee about all clean datasets, and about one of every fault: what it says of that one alone."""
    clean = {kind: paths for kind, paths in material.clean.items() if "dataset" in kind}
    spoiled = {p.name: p for p in planted if p.fault.on in clean}
    everything = [*(path for paths in clean.values() for path in paths), *(p.files[0] for p in spoiled.values())]
    said: dict[Path, dict[str, Opinion]] = {path: {} for path in everything}
    for name in DATASET_REFEREES:
        progress(f"referees: {name}")
        for path, opinions in ask_about(everything, [name]).items():
            said[path] |= opinions
    found = {fault: {name: news(opinion, [said[path][name] for path in clean[p.fault.on]])
                     for name, opinion in said[p.files[0]].items()} for fault, p in spoiled.items()}
    alarms = [f"{name} on {path.name}: {text}" for paths in clean.values() for path in paths
              for name, opinion in said[path].items() for text in unexpected(name, opinion)]
    return Asked(found, tuple(alarms))
