"""No candidate outlives the control loop, however that ends; and behind its fence it can reach nothing."""

import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.shadow import fence
from pipeline.shadow.riders import Riders

pytestmark = pytest.mark.xdist_group("shadow")
ENV = os.environ | {"PYTHONPATH": str(Path.cwd()), "OMP_NUM_THREADS": "1"}

LOOP = """
import sys, time
from pathlib import Path
from pipeline.shadow.riders import Riders
riders = Riders({name: Path(sys.argv[1]) for name in "ab"}, patient=False)
with riders:
    riders.ready()
    print(*riders.pids().values(), flush=True)
    time.sleep(600)
"""

FENCED = """
import os, socket, sys, threading
from pathlib import Path
from pipeline.shadow import fence
def attempt(name, call):
    try:
        call()
    except OSError as error:
        print(name, error.strerror)
    else:
        print(name, "done")
parent, here = os.getppid(), Path(sys.argv[1])
fence.drop_rights()
fence.limit(1 << 28, 30)
first = fence.enclose(reading=True)
attempt("read", lambda: os.open(here, os.O_RDONLY))
attempt("write", lambda: os.open(here, os.O_WRONLY))
attempt("create", lambda: os.open(here.with_name("new"), os.O_WRONLY | os.O_CREAT))
fence.no_more_files()
print("fences", first, fence.enclose(reading=False))
attempt("read again", lambda: os.open(here, os.O_RDONLY))
attempt("socket", lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM))
attempt("pipe", os.pipe)
attempt("kill", lambda: os.kill(parent, 0))
attempt("fork", os.fork)
attempt("run", lambda: os.execv(sys.executable, [sys.executable]))
attempt("remove", lambda: os.remove(here))
"""


def gone(pid: int) -> bool:
    """Whether a process is no more, or only its exit code is left for whoever has to read it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def all_gone(pids: list[int]) -> bool:
    until = time.monotonic() + 240
    while not all(map(gone, pids)) and time.monotonic() < until:
        time.sleep(0.02)
    return all(map(gone, pids))


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM], ids=lambda end: end.name)
def test_candidates_end_with_their_loop_even_one_that_is_stopped(files, end):
    loop = subprocess.Popen([sys.executable, "-c", LOOP, str(files["good"])], env=ENV, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    pids = [int(pid) for pid in loop.stdout.readline().split()]
    assert len(pids) == 2 and not any(map(gone, pids))
    os.kill(pids[0], signal.SIGSTOP)
    loop.send_signal(end)
    loop.wait(240)
    loop.stdout.close()
    assert all_gone(pids)


@pytest.mark.skipif(platform.machine() not in fence.CALLS, reason="the numbers of this machine's calls are not known")
def test_behind_the_fence_nothing_is_opened_started_or_signalled(tmp_path):
    here = tmp_path / "file"
    here.write_text("kept")
    told = subprocess.run([sys.executable, "-c", FENCED, str(here)], env=ENV, text=True, capture_output=True,
                          timeout=240, check=False)
    refused = "Operation not permitted"
    assert told.stdout.splitlines() == [
        "read done", f"write {refused}", f"create {refused}", "fences True True", f"read again {refused}",
        f"socket {refused}", f"pipe {refused}", f"kill {refused}", f"fork {refused}", f"run {refused}",
        f"remove {refused}"], told.stderr
    assert here.read_text() == "kept"


def test_a_candidate_has_no_rights_gives_way_and_its_threads_do_too(files):
    for patient, nice, idle in ((True, 10, False), (False, 19, True)):
        with Riders({"a": files["good"]}, patient=patient) as riders:
            riders.ready()
            pid = riders.pids()["a"]
            for task in Path(f"/proc/{pid}/task").iterdir():
                status = dict(line.split(":", 1) for line in (task / "status").read_text().splitlines())
                assert int(status["CapEff"], 16) == 0 and status["NoNewPrivs"].strip() == "1"
                assert status["Seccomp"].strip() == ("2" if platform.machine() in fence.CALLS else "0")
                assert os.getpriority(os.PRIO_PROCESS, int(task.name)) == nice
                assert (os.sched_getscheduler(int(task.name)) == os.SCHED_IDLE) is idle
            assert os.getsid(pid) == pid
        assert gone(pid)
