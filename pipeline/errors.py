"""Errors raised on purpose: each says what is wrong, where, and the mend."""


class HardcaseError(Exception):
    """Base of every error we raise on purpose.

    Args:
        what: what is wrong, in a few words.
        where: the file, field, topic or row it was found at.
        mend: what a person can do about it; a command where there is one.
    """

    def __init__(self, what: str, *, where: object, mend: str) -> None:
        self.what, self.where, self.mend = what, str(where), mend
        super().__init__(f"{what}\n  at:   {where}\n  mend: {mend}")

    def __reduce__(self) -> tuple[object, ...]:
        """Cross from a worker process whole: the default would call __init__ without `where` and `mend`."""
        return _again, (type(self), self.what, self.where, self.mend)


def _again(kind: "type[HardcaseError]", what: str, where: str, mend: str) -> "HardcaseError":
    return kind(what, where=where, mend=mend)


class RecordingError(HardcaseError):
    """A recording is damaged, hostile, incomplete or of the wrong kind."""


class StoreError(HardcaseError):
    """The store is locked, short of space, inconsistent, or does not hold what was asked for."""


class ConfigError(HardcaseError):
    """A name, recipe or value that cannot be used."""


class DatasetError(HardcaseError):
    """A dataset version cannot be built or does not hold what its manifest says."""


class ConsentError(HardcaseError):
    """A person did not consent to what is asked for, or does not any more."""


class RobotError(HardcaseError):
    """A robot or a person's input device is missing, gone, or refuses what was asked of it."""


class PolicyError(HardcaseError):
    """A policy file is refused or does not fit the robot."""


class GateError(HardcaseError):
    """The gate cannot judge what it was given, or a candidate did not earn its release."""


class SimulationError(HardcaseError):
    """A model does not load, or physics diverged."""


def unknown(kind: str, name: str, known: object) -> ConfigError:
    """The error for a name that is not in a table: it lists every valid one."""
    names = ", ".join(sorted(str(k) for k in known))  # type: ignore[attr-defined]
    return ConfigError(f"unknown {kind} {name!r}", where=f"--{kind} {name}", mend=f"use one of: {names}")


def one_line(error: BaseException) -> str:
    """The first line of a foreign error, or its kind where it says nothing."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
