"""Waiting for several links at once."""

from __future__ import annotations

import time
from collections.abc import Sequence

from agent.timing.clock import wait_readable
from agent.wire.link import Link

POLL_S = 0.001  # where a link has no descriptor to wait for


def wait_for_any(links: Sequence[Link], seconds: float) -> None:
    """Return when one of them has something to read or wants to be looked after, at the latest after `seconds`."""
    wakes_s = [wake_s for link in links if (wake_s := link.wake_s()) is not None]
    seconds = min([seconds, *wakes_s])
    if seconds <= 0.0:
        return
    descriptors = [link.transport.fileno() for link in links]
    present = [descriptor for descriptor in descriptors if descriptor is not None]
    if len(present) < len(descriptors):
        time.sleep(min(seconds, POLL_S))
        return
    wait_readable(present, seconds)
