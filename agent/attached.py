"""An agent that a host started ends with that host, even when it is killed: it holds ports that the next run wants."""

from __future__ import annotations

import os
import signal

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def end_with(parent: int) -> None:
    """Have the system send SIGTERM when the process that started this one, `parent`, ends; does so where it can."""
    import ctypes

    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    except (AttributeError, OSError):
        return
    if os.getppid() != parent:  # it ended before it could be said
        os.kill(os.getpid(), signal.SIGTERM)
