import subprocess
import sys
import time

from flows.memory import MemoryWatch, tree_pss_mb


def test_memory_of_a_child_and_of_its_child_counts():
    hold = "x = bytearray(b'x') * 80_000_000; import time; time.sleep(30)"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {hold!r}])"
    before = tree_pss_mb()
    child = subprocess.Popen([sys.executable, "-c", outer], start_new_session=True)
    try:
        with MemoryWatch(period_s=0.05) as watch:
            end = time.monotonic() + 20
            while watch.peak_mb < before + 80 and time.monotonic() < end:
                time.sleep(0.05)
        assert before + 80 <= watch.peak_mb < before + 160
    finally:
        import os
        import signal

        os.killpg(child.pid, signal.SIGKILL)
        child.wait()


def test_the_peak_stays_when_the_memory_is_given_back():
    with MemoryWatch(period_s=0.05) as watch:
        held = bytearray(b"x") * 100_000_000
        peak = watch.look()
        del held
        time.sleep(0.2)
    assert watch.peak_mb >= peak > 100
