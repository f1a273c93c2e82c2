"""Process of the agent: `python -m agent`. `xitl agent` uses the same entry."""

from __future__ import annotations

import gc
import os
import signal
import sys
from contextlib import ExitStack, suppress

import agent
from agent.assembly import REFUSALS, assemble
from agent.board.startup import notify_ready
from agent.options import COMPANION, WAITS_AT, parse
from agent.timing.realtime import set_up
from agent.wire.transport import open_transport

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_RETURNED_BYTES = 128 * 1024  # as glibc begins
_COLLECT_AFTER = 20_000
"""Objects that are created between two garbage collections. A cloud is thousands, and Python's 700 collect ten times
among them."""


def main(arguments: list[str] | None = None, program: str = "python -m agent") -> int:
    """Serve until interrupted.

    Return the exit code: 0 after an interrupt, 2 when the agent could not start.
    """
    gc.set_threshold(_COLLECT_AFTER)
    stop: list[int] = []
    parent = os.getppid()
    numbers = [signal.SIGINT, signal.SIGTERM]
    hang_up = getattr(signal, "SIGHUP", None)  # not on Windows
    if hang_up is not None and signal.getsignal(hang_up) is not signal.SIG_IGN:  # nohup ignores it: keep that
        numbers.append(hang_up)
    for number in numbers:
        signal.signal(number, lambda received, _frame: stop.append(received))
    with ExitStack() as opened:
        try:
            options = parse(arguments, program)
            if options.attached:
                end_with_parent(parent)
            if options.role == COMPANION:
                return_freed_memory()
            transport = opened.enter_context(open_transport(options.link, listen=True))
            node = assemble(transport, options, opened, say)
        except REFUSALS as error:
            red, plain = ("\033[1;31m", "\033[0m") if sys.stderr.isatty() else ("", "")
            sys.stderr.write(f"{red}error: {error}{plain}\n")
            return 2
        standing = set_up(options.realtime, options.cpus)
        node.identity = node.identity._replace(standing=standing)
        lines = [f"xitl agent {agent.__version__}: {node.role.title} {WAITS_AT} {transport.address}"]
        if node.role.addresses:
            lines.append(f"{node.role.peers}: {', '.join(node.role.addresses)}")
        for line in (*lines, *standing.problems):
            say(line)
        notify_ready()
        node.serve(lambda: not stop)
    return 0


def say(sentence: str) -> None:
    """Print a sentence to standard output. Ignore a closed output."""
    with suppress(OSError, ValueError):
        sys.stdout.write(f"{sentence}\n")
        sys.stdout.flush()


def return_freed_memory() -> None:
    """Make glibc return freed arrays to the system. Does nothing with other C libraries.

    Without it, glibc raises its limits when a large array is freed. The heap then keeps the working memory of the
    largest plan and cloud so far (mallopt(3), M_MMAP_THRESHOLD and M_TRIM_THRESHOLD).
    """
    import ctypes

    with suppress(AttributeError, OSError, TypeError):  # TypeError: Windows has no library of the process
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _RETURNED_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _RETURNED_BYTES)


def end_with_parent(parent: int) -> None:
    """Ask the system to send SIGTERM when the parent process `parent` ends, even when the parent is killed.

    An agent that a host started holds ports that the next run needs. Does nothing on systems without this call.
    """
    import ctypes

    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    except (AttributeError, OSError, TypeError):  # TypeError: Windows has no library of the process
        return
    if os.getppid() != parent:  # the parent ended before the call
        os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main())
