"""The fence around a candidate's process: what it gives up, in its own process, before it touches anybody's file.

A policy file is checked before it is run, and the arithmetic that it holds cannot act. The fence is for the day when
the runtime has a fault: then the process still has one socket to the control loop, and nothing else. Sources: the
manual pages prctl(2), seccomp(2), setrlimit(2), capset(2) and sched(7), and linux/audit.h, linux/filter.h and
asm/unistd.h for the numbers.
"""

import ctypes
import os
import platform
import resource
import signal
import struct
from pathlib import Path
from types import MappingProxyType
from typing import Any

PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS, CAPABILITY_VERSION_3 = 1, 38, 0x20080522
SET_MODE_FILTER, ALL_THREADS = 1, 1
LOAD, EQUAL, ANY, RETURN = 0x20, 0x15, 0x45, 0x06
"""BPF: load a word, jump if equal, jump if any bit is set, return."""
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | 1
"""Let the call through; fail it with EPERM, so that a library which probes for something goes on without."""
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC

type Numbers = MappingProxyType[str, int]

CALLS: MappingProxyType[str, tuple[int, Numbers]] = MappingProxyType({
    "x86_64": (0xC000003E, MappingProxyType({
        "read": 0, "write": 1, "close": 3, "fstat": 5, "lseek": 8, "mmap": 9, "mprotect": 10, "munmap": 11, "brk": 12,
        "rt_sigaction": 13, "rt_sigprocmask": 14, "rt_sigreturn": 15, "sched_yield": 24, "mremap": 25, "madvise": 28,
        "nanosleep": 35, "getpid": 39, "sendto": 44, "recvfrom": 45, "exit": 60, "getrusage": 98, "sigaltstack": 131,
        "gettid": 186, "futex": 202, "sched_getaffinity": 204, "restart_syscall": 219, "clock_gettime": 228,
        "clock_nanosleep": 230, "exit_group": 231, "getcpu": 309, "getrandom": 318, "membarrier": 324, "rseq": 334})),
    "aarch64": (0xC00000B7, MappingProxyType({
        "read": 63, "write": 64, "close": 57, "fstat": 80, "lseek": 62, "mmap": 222, "mprotect": 226, "munmap": 215,
        "brk": 214, "rt_sigaction": 134, "rt_sigprocmask": 135, "rt_sigreturn": 139, "sched_yield": 124, "mremap": 216,
        "madvise": 233, "nanosleep": 101, "getpid": 172, "sendto": 206, "recvfrom": 207, "exit": 93, "getrusage": 165,
        "sigaltstack": 132, "gettid": 178, "futex": 98, "sched_getaffinity": 123, "restart_syscall": 128,
        "clock_gettime": 113, "clock_nanosleep": 115, "exit_group": 94, "getcpu": 168, "getrandom": 278,
        "membarrier": 283, "rseq": 293})),
})
"""Machine -> its number in an audit record, and the calls that arithmetic and one open socket need."""

READING = MappingProxyType({
    "x86_64": MappingProxyType({"openat": 257, "newfstatat": 262, "ioctl": 16, "getdents64": 217, "readlink": 89,
                                "uname": 63, "getcwd": 79, "sysinfo": 99, "fcntl": 72, "prlimit64": 302,
                                "seccomp": 317}),
    "aarch64": MappingProxyType({"openat": 56, "newfstatat": 79, "ioctl": 29, "getdents64": 61, "readlinkat": 78,
                                 "uname": 160, "getcwd": 17, "sysinfo": 179, "fcntl": 25, "prlimit64": 261,
                                 "seccomp": 277}),
})
"""Calls that are allowed as well while the file is loaded; openat only for reading."""


def die_with(parent: int) -> None:
    """Have the kernel kill this process, stopped or not, when the thread that started it ends."""
    _libc().prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended before we asked
        raise SystemExit(0)


def step_back(*, idle: bool) -> None:
    """Give way to the champion.

    Args:
        idle: run only where nobody else wants the core; else with a tenth of the weight, for a clock that waits.
    """
    os.nice(19 if idle else 10)
    if idle:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def limit(memory_bytes: int, cpu_s: float) -> None:
    """Memory beyond what is mapped now, CPU time in all, no file written, no dump of memory."""
    mapped = int(_status("VmSize")) * 1024 + memory_bytes
    seconds = max(1, round(cpu_s))
    for kind, value in ((resource.RLIMIT_AS, mapped), (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(kind, (value, value))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))  # SIGXCPU first: it tells why


def no_more_files() -> None:
    """From now on nothing can be opened: no file, no socket, no pipe; what is open stays open."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))


def drop_rights() -> None:
    """Keep no right of root's, and get none by running another program; before a library starts a thread."""
    libc = _libc()
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.capset(struct.pack("<Ii", CAPABILITY_VERSION_3, 0), bytes(24))


def enclose(*, reading: bool) -> bool:
    """Refuse every system call but a few in all threads, for good; needs `drop_rights` before.

    A second fence can only be tighter.

    Args:
        reading: whether files may still be opened, for reading.

    Returns:
        Whether the fence is up: not on other machines, nor where the kernel does not know it.
    """
    machine = platform.machine()
    if machine not in CALLS:
        return False
    audit, calls = CALLS[machine]
    reads = dict(READING[machine]) if reading else {}
    program = _program(audit, sorted([*calls.values(), *reads.values()]), reads.get("openat"))
    code = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *line) for line in program))
    head = struct.pack("@HxxxxxxP", len(program), ctypes.addressof(code))
    return _libc().syscall(READING[machine]["seccomp"], SET_MODE_FILTER, ALL_THREADS, head) == 0


def _program(audit: int, allowed: list[int], openat: int | None) -> list[tuple[int, int, int, int]]:
    """A filter over struct seccomp_data: number at 0, machine at 4, argument k at 16 + 8 k."""
    lines = [(LOAD, 0, 0, 4), (EQUAL, 1, 0, audit), (RETURN, 0, 0, REFUSE), (LOAD, 0, 0, 0)]
    if openat is not None:
        lines += [(EQUAL, 0, 4, openat), (LOAD, 0, 0, 16 + 8 * 2), (ANY, 0, 1, WRITING), (RETURN, 0, 0, REFUSE),
                  (RETURN, 0, 0, ALLOW)]
    for number in allowed:
        lines += [(EQUAL, 0, 1, number), (RETURN, 0, 0, ALLOW)]
    return [*lines, (RETURN, 0, 0, REFUSE)]


def _status(name: str) -> str:
    lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    return next(line.split()[1] for line in lines if line.startswith(f"{name}:"))


def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)
