"""Finding and CheckVerdict: what a check saw in a recording or dataset, and whether it may teach a policy."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name, Sha256, ShortId

type Severity = Literal["error", "warning"]
"""An error keeps the data out of training; a warning is shown and changes nothing."""


class Finding(Frozen):
    """One thing that is wrong: what, where, when, how much against which limit, and the mend."""

    check: Name = Field(description="key of CHECKS")
    severity: Severity = "error"
    what: str = Field(description="what is wrong, in a few words")
    where: str = Field(description="topic, field and column, file, or episode")
    at_s: float | None = Field(default=None, description="time from the recording's first message [s]")
    frame: int | None = Field(default=None, ge=0, description="row or message, from 0")
    value: float | None = Field(default=None, description="what was measured, in the unit that `what` names")
    limit: float | None = Field(default=None, description="what would have been accepted, same unit")
    mend: str = Field(description="what a person can do about it")

    def line(self) -> str:
        """The finding in one line, without its mend."""
        return f"{self.check}: {self.what} ({self.place()})"

    def place(self) -> str:
        """Where and when, as people say it."""
        time = "" if self.at_s is None else f" at {self.at_s:.2f} s"
        row = "" if self.frame is None else f", frame {self.frame}"
        return f"{self.where}{time}{row}"


class CheckVerdict(Frozen):
    """What all checks together say of one file or folder, by one contract and one version of the code."""

    id: ShortId = Field(description="follows from subject, contract and code")
    subject: Sha256 = Field(description="sha256 of the recording's bytes, or digest of the dataset's files")
    kind: Literal["recording", "dataset"]
    name: str = Field(description="file name, or id of the episode or version; never a path of this machine")
    contract: Sha256
    code: Sha256 = Field(description="hash of the checks' source files")
    beside: Sha256 | None = Field(default=None, description="hash over the recordings it was compared with, in order")
    passed: bool = Field(description="no finding is an error")
    checks: tuple[Name, ...] = Field(description="checks that ran")
    skipped: dict[Name, str] = Field(description="checks that had nothing to look at, and what they lacked")
    findings: tuple[Finding, ...]

    @model_validator(mode="after")
    def errors_fail(self) -> Self:
        """A verdict passes exactly when none of its findings is an error."""
        errors = sum(f.severity == "error" for f in self.findings)
        if self.passed == bool(errors):
            raise ValueError(f"passed={self.passed} with {errors} errors")
        return self

    @property
    def reason(self) -> str:
        """The first error and how many more there are, in one line; empty where it passed."""
        errors = [f for f in self.findings if f.severity == "error"]
        more = f" and {len(errors) - 1} more" if len(errors) > 1 else ""
        return errors[0].line() + more if errors else ""
