"""Signals by which a person, a batch system or a terminal that hangs up ends a command."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType


@contextmanager
def end_signals_handled(end: Callable[[int, FrameType | None], None], *more: signal.Signals) -> Iterator[None]:
    """SIGTERM, SIGHUP and `more` call `end`; what was in force before is again afterwards. For the main thread alone.

    A SIGHUP that is ignored already, as under `nohup`, stays so.
    """
    numbers: Sequence[signal.Signals] = (signal.SIGTERM, *more)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers = (*numbers, signal.SIGHUP)
    previous = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
