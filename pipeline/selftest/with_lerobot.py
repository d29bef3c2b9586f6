"""lerobot as a referee: LeRobotDataset opens a folder and gives every sample, each warning an error."""

import json
import logging
import sys
import warnings

REPO = "hardcase/version"
"""A name that lerobot asks for; nothing is looked up under it."""


class _Warned(logging.Handler):
    """Keeps what is logged as a warning or worse."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.said.append(f"{record.name} {record.getMessage()}")


def complaints(folder: str) -> list[str]:
    """What lerobot says against a folder while it gives every sample of it: the error, and what it logged."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # pyright: ignore[reportMissingTypeStubs]

    found, warned = list[str](), _Warned()
    logging.getLogger().addHandler(warned)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # named, because lerobot warns where torchcodec finds no FFmpeg
            data = LeRobotDataset(REPO, root=folder, video_backend="pyav")
            for k in range(len(data)):
                data[k]
    except Exception as error:  # lerobot raises whatever its libraries raise
        found.append(f"{type(error).__name__} {error}")
    finally:
        logging.getLogger().removeHandler(warned)
    return found + warned.said


def main() -> int:
    """Read the folder that the command line names; prints what is wrong as JSON, returns 1 where something is."""
    found = complaints(sys.argv[1])
    print(json.dumps(found))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
