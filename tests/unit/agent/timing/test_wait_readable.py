"""Waiting for several descriptors, low and high ones."""

from __future__ import annotations

import os
import resource
import time

import pytest

from agent.timing.clock import wait_readable


@pytest.mark.parametrize("least", [3, 1100])
def test_it_returns_with_the_first_that_is_readable(least: int) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if least > soft:
        if hard != resource.RLIM_INFINITY and hard <= least:
            pytest.skip("so many descriptors are not permitted here")
        resource.setrlimit(resource.RLIMIT_NOFILE, (2048, hard))
    read, write = os.pipe()
    other, other_end = os.pipe()
    high = os.dup2(read, least + other_end) if least > 3 else read
    try:
        begun_s = time.monotonic()
        wait_readable((other, high), 0.02)
        assert time.monotonic() - begun_s >= 0.019
        os.write(write, b"x")
        wait_readable((other, high), 600.0)  # a minute and more would not go unnoticed
    finally:
        for descriptor in {read, write, other, other_end, high}:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
