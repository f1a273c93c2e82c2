"""Signals with which a user, a batch system or a closed terminal ends a command."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType


@contextmanager
def end_signals_handled(end: Callable[[int, FrameType | None], None], *more: signal.Signals) -> Iterator[None]:
    """Let SIGTERM, SIGHUP and `more` call `end`; restore the former handlers afterwards. For the main thread only.

    A SIGHUP that is already ignored, as under `nohup`, stays ignored. Windows has no SIGHUP.
    """
    numbers: Sequence[signal.Signals] = (signal.SIGTERM, *more)
    hang_up = getattr(signal, "SIGHUP", None)
    if hang_up is not None and signal.getsignal(hang_up) is not signal.SIG_IGN:
        numbers = (*numbers, hang_up)
    previous = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
