"""All checks over one subject, and the verdict."""

from collections.abc import Collection
from functools import cache
from pathlib import Path

import numpy as np

from pipeline.check.contract import completed
from pipeline.check.signals import Subject
from pipeline.check.table import CHECKS
from pipeline.files import sha256, short_id, source_hash
from schemas.contract import Contract
from schemas.finding import CheckVerdict, Finding


def check(subject: Subject, contract: Contract, names: Collection[str] = CHECKS.keys()) -> CheckVerdict:
    """Run every check that has something to look at.

    Args:
        subject: from read_recording or read_folder.
        contract: what is expected; where it says nothing, the data's own words count (see contract.completed).
        names: the checks to run; all of them by default.
    """
    whole = completed(contract, subject)
    findings: list[Finding] = []
    skipped: dict[str, str] = {}
    ran: list[str] = []
    for name, entry in ((n, e) for n, e in CHECKS.items() if n in names):
        lack = entry.lacks(subject, whole)
        if lack:
            skipped[name] = lack
            continue
        ran.append(name)
        with np.errstate(all="ignore"):  # absurd values overflow: that is a finding, not a warning on the screen
            findings += entry.run(subject, whole)
    terms, code = sha256(contract.model_dump_json().encode()), code_hash()
    return CheckVerdict(
        id=short_id("check", subject.digest, terms, code), subject=subject.digest, kind=subject.kind, name=subject.name,
        contract=terms, code=code, passed=not any(f.severity == "error" for f in findings), checks=tuple(ran),
        skipped=skipped, findings=tuple(findings))


@cache
def code_hash() -> str:
    """Hash of the sources that decide a verdict: the checks and what reads the logs."""
    here = Path(__file__).parent
    return source_hash([*here.glob("*.py"), *(here.parent / "logs").glob("*.py"),
                        here.parents[1] / "schemas" / "contract.py"])
