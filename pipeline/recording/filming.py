"""Filming: cameras read in a thread of their own, their pictures handed to a recording as they come."""

import threading
from types import TracebackType
from typing import Self

from pipeline.errors import HardcaseError
from pipeline.protocols import Cameras
from pipeline.recording.live import LiveRecorder

_WAIT_S = 0.1
"""Longest a camera may keep the thread from noticing the end [s]."""


class Filming:
    """Reads cameras until it is stopped; neither a slow camera nor a broken one holds up whoever controls the robot.

    Args:
        recorder: takes the pictures; filming is stopped before it is closed.
        cameras: what to read; opened, read and closed in the thread.

    Raises:
        HardcaseError: the cameras do not open: no rendering here, no such camera, no such device. The recording
            can go on without.
    """

    def __init__(self, recorder: LiveRecorder, cameras: Cameras) -> None:
        self._recorder, self._cameras = recorder, cameras
        self._stop, self._opened = threading.Event(), threading.Event()
        self.error: HardcaseError | None = None
        """What ended the filming before it was stopped."""
        self.taken: dict[str, int] = {}
        """Camera -> pictures so far."""
        self._thread = threading.Thread(target=self._film, name="cameras", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self.error is not None:
            self._thread.join()
            raise self.error

    def _film(self) -> None:
        try:
            self._cameras.open()
            self._opened.set()
            while not self._stop.is_set():
                for picture in self._cameras.read(_WAIT_S):
                    self.taken[picture.camera] = self.taken.get(picture.camera, 0) + 1
                    self._recorder.image(picture.camera, picture.pixels, tick=picture.tick, stamp_ns=picture.stamp_ns)
        except HardcaseError as error:
            self.error = error
            self._recorder.event("camera", error.what, level=40)
        finally:
            self._cameras.close()
            self._opened.set()

    def stop(self) -> None:
        """End the filming; pictures that were taken are in the recording's queue."""
        self._stop.set()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.stop()
