"""Waiting for bytes from several sides at once, no longer than until the next deadline."""

from __future__ import annotations

import select
from collections.abc import Sequence

_MOST_FOR_SELECT = 1024  # FD_SETSIZE


def wait_readable(descriptors: Sequence[int], timeout_s: float) -> None:
    """Return once one of the descriptors is readable, or after timeout_s.

    select() ends on the microsecond where poll() and epoll round up to whole milliseconds, but cannot take a descriptor
    from 1024 on.
    """
    if max(descriptors) < _MOST_FOR_SELECT:
        select.select(descriptors, (), (), timeout_s)
        return
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    poll.poll(timeout_s * 1000.0)
