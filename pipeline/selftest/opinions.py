"""What referees say of files and folders."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Opinion:
    """What a referee says of one file or folder; each text begins with a code of its own."""

    passed: bool
    reasons: tuple[str, ...]
    """Findings that fail it; ('refused',) where it cannot be read."""
    remarks: tuple[str, ...] = ()
    """Findings that do not."""

    @property
    def word(self) -> str:
        """Its codes for a table: those of remarks alone in parentheses, a dash where there are none."""
        fails, told = ([*dict.fromkeys(text.split()[0] for text in texts)] for texts in (self.reasons, self.remarks))
        return ", ".join([*fails, *(f"({code})" for code in told if code not in fails)]) or "-"


@dataclass(frozen=True, slots=True)
class Asked:
    """What referees say of planted files and folders, and what they find wrong with clean ones."""

    planted: Mapping[str, Mapping[str, Opinion]]
    """Fault -> referee -> what it says of the first file or folder that the fault was planted in."""
    alarms: tuple[str, ...]
    """What a referee finds wrong with clean material of ours, a line each."""

    def __or__(self, other: "Asked") -> "Asked":
        return Asked({**self.planted, **other.planted}, (*self.alarms, *other.alarms))
