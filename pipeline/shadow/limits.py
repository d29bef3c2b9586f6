"""What a candidate may take."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one candidate's process, over all that it does until it is closed."""

    memory_bytes: int = 256 << 20
    """Address space beyond that of the interpreter with its libraries, about 180 MB of which 60 are used [B]."""
    cpu_s: float = 60.0
    """CPU time, loading included [s]; the kernel counts whole seconds and ends the process."""
    load_s: float = 60.0
    """Wall time until it has loaded its file; a busy machine is slow [s]."""
    answer_s: float = 20.0
    """How long a question may stay open before the candidate counts as hung [s]."""
    patience_s: float = 120.0
    """How long a clock that waits, waits for it in total [s]."""
