"""Scheduling, memory and processors: in a process of its own, as nothing of it can be taken back."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from agent.timing import realtime
from tests.golden import Golden


def in_a_process(body: str, prepare: str = "") -> Any:
    """What `body` puts into `told`."""
    program = f"import json, os, sys\nfrom agent.timing import realtime\n{prepare}\n{body}\nprint(json.dumps(told))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def may_schedule() -> bool:
    body = "told = realtime.schedule(5)"
    return bool(in_a_process(body) == "")


UNPRIVILEGED = """
import ctypes, resource
resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 16, 1 << 16))
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
os.setgid(65534)
os.setuid(65534)
"""
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become a user without permissions")


def test_fifo_for_every_thread_and_memory_locked_where_that_is_permitted() -> None:
    if not may_schedule():
        pytest.skip("SCHED_FIFO is not permitted here")
    told = in_a_process(
        """
import threading
done = threading.Event()
thread = threading.Thread(target=done.wait)
thread.start()
standing = realtime.set_up(42, ())
status = open("/proc/self/status").read()
told = [standing, [(os.sched_getscheduler(tid), os.sched_getparam(tid).sched_priority)
                   for tid in map(int, os.listdir("/proc/self/task"))], status]
done.set()
"""
    )
    (priority, locked, pinned, said), threads, status = told
    assert (priority, pinned) == (42, False)
    assert threads == [[os.SCHED_FIFO, 42]] * 2
    locked_kib = int(next(line for line in status.splitlines() if line.startswith("VmLck")).split()[1])
    assert locked == (locked_kib > 0) == (said == [])


@as_root
def test_without_permission_one_sentence_each(golden: Golden) -> None:
    said = in_a_process("told = realtime.set_up(50, (0,))", prepare=UNPRIVILEGED)
    assert said[:3] == [0, False, True]
    memory, scheduling = said[3]
    golden("text", memory)
    golden("second text", scheduling, "50")


def test_pinned_to_a_processor_with_its_threads() -> None:
    cpu = min(os.sched_getaffinity(0))
    told = in_a_process(
        f"""
import threading
done = threading.Event()
threading.Thread(target=done.wait).start()
standing = realtime.set_up(0, ({cpu},))
told = [standing, [sorted(os.sched_getaffinity(tid)) for tid in map(int, os.listdir("/proc/self/task"))]]
done.set()
"""
    )
    assert told == [[0, False, True, []], [[cpu]] * 2]


def test_processors_that_are_not_there_change_nothing() -> None:
    before = sorted(os.sched_getaffinity(0))
    there = ", ".join(map(str, before))
    said, after = in_a_process(f"told = [realtime.pin(({before[0]}, 4000)), sorted(os.sched_getaffinity(0))]")
    assert said == f"not pinned: processor 4000 is not available; use one of {there}"
    assert after == before


def test_what_is_started_meanwhile_is_ordinary() -> None:
    if not may_schedule():
        pytest.skip("SCHED_FIFO is not permitted here")
    told = in_a_process(
        """
import subprocess
realtime.schedule(7)
with realtime.ordinary():
    child = subprocess.run([sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"], capture_output=True)
told = [int(child.stdout), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority]
"""
    )
    assert told == [os.SCHED_OTHER, os.SCHED_FIFO, 7]


def test_a_thread_that_ends_meanwhile_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Thread(target=lambda: None)
    ended.start()
    ended.join()
    assert ended.native_id is not None
    listed = [str(ended.native_id), str(threading.get_native_id())]
    monkeypatch.setattr(os, "listdir", lambda _: listed)
    realtime.unschedule()
    assert realtime.pin(sorted(os.sched_getaffinity(0))) == ""


def test_nothing_asked_nothing_said() -> None:
    assert in_a_process("told = realtime.set_up(0, ())") == [0, False, False, []]


def test_an_unlimited_limit_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    infinite = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda which: infinite)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=lambda flags: 0))
    assert realtime.lock_memory() == ""
