"""Report: what a loop came to, as one HTML file."""

from pathlib import Path

from pipeline.errors import ConfigError
from pipeline.files import atomic
from pipeline.report.data import ReportData
from pipeline.report.page import page


def report(data: ReportData, path: Path) -> Path:
    """Write the report whole or not at all; it opens from disk in any browser, without a network.

    Raises:
        ConfigError: `path` cannot be written.
    """
    html = page(data).encode()
    try:
        with atomic(path) as stream:
            stream.write(html)
    except OSError as error:
        raise ConfigError(f"the report cannot be written: {error.strerror or error}", where=path,
                          mend="name a file in a folder you may write to, on a disk with space") from error
    return path
