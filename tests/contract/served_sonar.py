"""A sonar in front of a wall, served at a URL, in real time: what a client of the Ping360 meets."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from sim_core.sensors.sonar import Below, PingSettings, ScanningSonar
from sim_core.sensors.spec import SonarSpec
from sim_core.world.geometry import STEEL, Plane
from sim_core.world.primitive_rays import PrimitiveCaster
from xitl_cli.run.sensors.ping360 import Ping360Port

WALL_M = 6.0  # to the north


@contextmanager
def served(url: str) -> Iterator[Ping360Port]:
    """The port, polled every 2.5 ms as a run does."""
    sonar, rng = ScanningSonar(SonarSpec(position_frd_m=(0.0, 0.0, 0.0))), default_rng(1)
    below = Below(PrimitiveCaster([Plane(np.array([-1.0, 0.0, 0.0]), -WALL_M, STEEL)]), -2.0)
    port = Ping360Port(url)
    stop = threading.Event()

    def echo(settings: PingSettings) -> NDArray[np.uint8]:
        return sonar.echo(settings, np.zeros(3), np.eye(3), below, rng)

    def world() -> None:
        start_ns = time.monotonic_ns()
        while not stop.wait(0.0025):
            port.poll(time.monotonic_ns() - start_ns, echo)

    thread = threading.Thread(target=world, name="sonar's world")
    thread.start()
    try:
        yield port
    finally:
        stop.set()
        thread.join()
        port.close()
