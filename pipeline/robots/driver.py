"""Asking a driver that is not ours: it may fail with any error, and then a person is told in one line."""

from collections.abc import Callable

from pipeline.errors import RobotError, one_line


def asked[T](name: str, what: str, call: Callable[..., T], *arguments: object, where: str, mend: str) -> T:
    """What a driver answers.

    Args:
        name: of the device.
        what: what it does where the call fails: 'does not connect'.
        call: of the driver.
        arguments: for the call.
        where: named in the error.
        mend: in the error.

    Raises:
        RobotError: the driver fails, with whatever error.
    """
    try:
        return call(*arguments)
    except Exception as error:  # drivers raise what they like
        raise RobotError(f"{name} {what}: {one_line(error)}", where=where, mend=mend) from error
