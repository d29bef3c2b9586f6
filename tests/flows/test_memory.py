import subprocess
import sys
import time
from pathlib import Path

from flows.service.memory import MemoryWatch, tree_pss_mb


def test_memory_of_a_child_and_of_its_child_counts():
    hold = "x = bytearray(b'x') * 80_000_000; import time; time.sleep(30)"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {hold!r}])"
    before = tree_pss_mb()
    child = subprocess.Popen([sys.executable, "-c", outer], start_new_session=True)
    try:
        with MemoryWatch(period_s=0.05) as watch:
            end = time.monotonic() + 240
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


def held_mb_around(work: str) -> tuple[float, float]:
    """Memory of a fresh process before and after `work`, which may call what is in flows.service.memory."""
    code = ("import os; from flows.service.memory import frugal, give_back, pss_mb\n"
            f"print(pss_mb(os.getpid()))\n{work}\nprint(pss_mb(os.getpid()))")
    told = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], check=True, text=True,
                          capture_output=True).stdout.split()
    return float(told[0]), float(told[1])


HOLES = "blocks = [bytearray(b'x' * 50_000) for _ in range(4000)]; last = blocks.pop(); del blocks"


def test_holes_in_the_heap_go_back_to_the_system():
    before, kept = held_mb_around(HOLES)
    assert kept > before + 150, "the C library keeps what lies below the newest block"
    before, after = held_mb_around(f"{HOLES}; give_back()")
    assert after < before + 30


LARGE_AFTER_LARGE = "\n".join([
    "a = bytearray(b'x' * 30_000_000); del a",
    "blocks = [bytearray(b'x') * 20_000_000 for _ in range(5)]; small = bytearray(100_000); del blocks"])


def test_large_arrays_go_back_at_once_in_a_frugal_process():
    before, kept = held_mb_around(LARGE_AFTER_LARGE)
    assert kept > before + 50, "the C library came to keep large blocks"
    before, after = held_mb_around(f"frugal()\n{LARGE_AFTER_LARGE}")
    assert after < before + 15
