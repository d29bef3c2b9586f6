"""One error for whatever goes wrong in a file, and the mends that several of its readers give."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import RecordingError

SPLIT = "split it: mcap filter IN -o OUT --start ... --end ..."
REPACK = "repack it: mcap compress IN -o OUT"
DAMAGED = "fetch the recording again from its robot, or drop the episode: damaged data is never used"


def refuse(what: str, where: object, mend: str) -> RecordingError:
    """A RecordingError."""
    return RecordingError(what, where=where, mend=mend)


@contextmanager
def reading(where: Path, part: str) -> Generator[None]:
    """One error for whatever the libraries below raise: ZstdError, struct.error, UnicodeDecodeError, ..."""
    try:
        yield
    except (RecordingError, MemoryError):
        raise
    except OSError as error:
        raise refuse(f"{part} cannot be read: {error.strerror}", where, "check the path and its permissions") from error
    except Exception as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        raise refuse(f"{part} is damaged: {cause[:200]}", where, DAMAGED) from error


def not_mcap(where: Path) -> RecordingError:
    """The error for a file of another kind."""
    return refuse("not an MCAP file (bad magic at byte 0)", where,
                  "name a .mcap recording; older bags are converted by: mcap convert IN OUT.mcap")


def ends_early(messages: int, seconds: float, where: Path) -> RecordingError:
    """The error for a file that was cut off."""
    return refuse(f"episode ends early after message {messages} (t = {seconds:.2f} s); recovered "
                  f"{messages}; pass --accept-truncated to keep it", where,
                  "pass --accept-truncated to keep what is whole, or record the episode again")
