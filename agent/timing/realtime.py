"""Linux settings for a process with deadlines: fixed priority, locked memory, dedicated processors.

Each function returns an empty text on success, otherwise one sentence with failure, cause and remedy. Missing
permissions never raise: an agent without them still works, and reports its timing.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

DEFAULT_PRIORITY = 50
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
SWITCH_S = 0.001  # longest delay by a thread that writes a log; Python's default is 5 ms
_CAP_IPC_LOCK = 14


class RealtimeState(NamedTuple):
    """Real-time state of the process."""

    priority: int = 0
    """Priority of SCHED_FIFO, 0 for none."""
    memory_locked: bool = False
    pinned: bool = False
    problems: tuple[str, ...] = ()
    """Requests that failed."""


def set_up(priority: int, cpus: Sequence[int]) -> RealtimeState:
    """Pin to `cpus` if any. With a priority above 0, lock memory and schedule by SCHED_FIFO.

    This applies to all present and later threads. Call it after everything permanent has been loaded.
    """
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()  # exclude everything loaded so far from later collections
    pinned = pin(cpus) if cpus else ""
    locked = lock_memory() if priority else ""
    scheduled = schedule(priority) if priority else ""
    return RealtimeState(
        priority=priority if priority and not scheduled else 0,
        memory_locked=bool(priority and not locked),
        pinned=bool(cpus and not pinned),
        problems=tuple(sentence for sentence in (pinned, locked, scheduled) if sentence),
    )


def schedule(priority: int) -> str:
    """Schedule by SCHED_FIFO at `priority`, 1 to 99."""
    if not hasattr(os, "sched_setscheduler"):
        return "no SCHED_FIFO: this system does not offer it; real-time scheduling needs Linux"
    try:
        _for_all_threads(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority)))
    except OSError as error:
        return (
            f"no SCHED_FIFO at priority {priority} ({error.strerror}); start as root or allow it by LimitRTPRIO in the "
            "systemd unit or rtprio in /etc/security/limits.conf"
        )
    return ""


def unschedule() -> None:
    """Schedule every thread of this process in the ordinary way again."""
    if not hasattr(os, "sched_setscheduler"):
        return
    _for_all_threads(lambda thread: os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0)))


@contextmanager
def ordinary() -> Iterator[None]:
    """Context without SCHED_FIFO, so that processes started in it do not inherit it."""
    if not hasattr(os, "sched_getscheduler") or os.sched_getscheduler(0) != os.SCHED_FIFO:
        yield
        return
    before = os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_FIFO, before)


def lock_memory() -> str:
    """Lock all pages in memory once they are touched, future ones too (mlockall with MCL_ONFAULT)."""
    advice = "start as root or set LimitMEMLOCK=infinity in the systemd unit"
    absent = "memory is not locked: this system does not offer it; locking needs Linux"
    if sys.platform != "linux":
        return absent
    if not _may_lock_all():
        return f"memory is not locked (the limit is finite and may be too low later); {advice}"
    import ctypes

    try:
        lock = ctypes.CDLL(None, use_errno=True).mlockall
    except (AttributeError, OSError):
        return absent
    if lock(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        return f"memory is not locked ({os.strerror(ctypes.get_errno())}); {advice}"
    return ""


def _may_lock_all() -> bool:
    """Whether all memory may be locked. Under a finite limit, a lock would succeed and let a later allocation fail."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if resource.RLIM_INFINITY in (soft, hard):
        if soft != hard:
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, hard))
        return True
    try:
        with open("/proc/self/status") as status:  # noqa: PTH123  as in agent.machine
            effective = next(line for line in status if line.startswith("CapEff:"))
        return bool(int(effective.split()[1], 16) >> _CAP_IPC_LOCK & 1)
    except (OSError, ValueError, IndexError, StopIteration):
        return os.geteuid() == 0


def _for_all_threads(change: Callable[[int], None]) -> None:
    """Call `change` with each thread of this process; with 0, the calling one, if the system does not list them."""
    try:
        threads = [int(name) for name in os.listdir("/proc/self/task")]  # noqa: PTH208  names are all that is wanted
    except OSError:
        threads = [0]
    for thread in threads:
        with suppress(ProcessLookupError):  # it ended after it was listed
            change(thread)


def pin(cpus: Sequence[int]) -> str:
    """Run only on these processors."""
    if not hasattr(os, "sched_setaffinity"):
        return "not pinned: this system does not offer it; CPU affinity needs Linux"
    before = os.sched_getaffinity(0)
    try:
        _for_all_threads(lambda thread: os.sched_setaffinity(thread, cpus))
        missing = sorted(set(cpus) - os.sched_getaffinity(0))
    except (OSError, ValueError, OverflowError):
        missing = sorted(set(cpus) - before)
    if not missing:
        return ""
    _for_all_threads(lambda thread: os.sched_setaffinity(thread, before))
    wanted, available = (", ".join(map(str, some)) for some in (missing, sorted(before)))
    return f"not pinned: processor {wanted} is not available; use one of {available}"
