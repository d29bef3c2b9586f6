"""Filming: cameras read in a thread of their own, their pictures handed to a recording as they come."""

import threading
from types import TracebackType
from typing import Self

from pipeline.errors import HardcaseError
from pipeline.protocols import Cameras
from pipeline.recording.live import LiveRecorder
from pipeline.recording.ring import RingRecorder

_WAIT_S = 0.1
"""Longest a camera may keep the thread from noticing the end [s]."""

_LAST = 100
"""Readings after the end, for cameras that are behind; one that never runs dry is cut off there."""


class Filming:
    """Reads cameras until it is stopped; neither a slow camera nor a broken one holds up whoever controls the robot.

    Args:
        recorder: takes the pictures; filming is stopped before it is closed.
        cameras: what to read; opened, read and closed in the thread.

    Raises:
        HardcaseError: the cameras do not open: no rendering here, no such camera, no such device. The recording
            can go on without.
    """

    def __init__(self, recorder: LiveRecorder | RingRecorder, cameras: Cameras) -> None:
        self._recorder, self._cameras = recorder, cameras
        self._stop, self._opened, self._ready = threading.Event(), threading.Event(), False
        self._bug: Exception = RuntimeError("cameras ended without a word")
        self.error: HardcaseError | None = None
        """What ended the filming before it was stopped."""
        self.taken: dict[str, int] = {}
        """Camera -> pictures so far."""
        self._thread = threading.Thread(target=self._film, name="cameras", daemon=True)
        self._thread.start()
        self._opened.wait()
        if not self._ready:
            self._thread.join()
            raise self.error or self._bug

    def _film(self) -> None:
        try:
            self._cameras.open()
            self._ready = True
            self._opened.set()
            while not self._stop.is_set():
                self._hand_on(_WAIT_S)
            for _ in range(_LAST):
                if not self._hand_on(0.0):
                    break
            if self._cameras.skipped:
                text = f"{self._cameras.skipped} moments not taken: the cameras are slower than the robot"
                self._recorder.event("camera", text, level=30)
                for camera in self.taken:
                    self._recorder.skipped(camera, self._cameras.skipped)
        except HardcaseError as error:
            self.error = error
            self._recorder.event("camera", error.what, level=40)
        except Exception as error:
            self._bug = error
            raise
        finally:
            self._cameras.close()
            self._opened.set()

    def _hand_on(self, timeout_s: float) -> bool:
        """Record what the cameras have; whether they had anything."""
        pictures = self._cameras.read(timeout_s)
        for picture in pictures:
            self.taken[picture.camera] = self.taken.get(picture.camera, 0) + 1
            self._recorder.image(picture.camera, picture.pixels, tick=picture.tick, stamp_ns=picture.stamp_ns)
        return len(pictures) > 0

    def stop(self) -> None:
        """End the filming, once what the cameras were shown is in the recording's queue."""
        self._stop.set()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.stop()
