"""What candidates of one robot are asked: how much it perceives, how much they answer, and what kind they are."""

from dataclasses import dataclass

from pipeline.frames import ACTION, ENVIRONMENT, STATE


@dataclass(frozen=True, slots=True)
class Sizes:
    """Widths of a question and of its answer; those of the reference arm by default."""

    kind: str = "chunked"
    """How a candidate's file is opened: chunked, or ppo for legged robots."""
    state: int = len(STATE)
    environment: int = len(ENVIRONMENT)
    action: int = len(ACTION)


ARM = Sizes()


def legged(width: int, joints: int) -> Sizes:
    """Sizes of a legged robot that senses `width` values and has `joints` joints."""
    return Sizes("ppo", width, 0, joints)
