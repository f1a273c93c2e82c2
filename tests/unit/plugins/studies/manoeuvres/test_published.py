"""The published runs entered as data are those of the published equations, integrated on their own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.oracles import otter, wamv
from tests.oracles.cybership2 import CyberShip2
from tests.oracles.otter import Otter
from tests.oracles.wamv import WamV
from xitl_cli.plugins.studies.manoeuvres.published import RUNS, PublishedRun


def assert_same(run: PublishedRun, states: np.ndarray, dt_s: float, rate: int, heading: int) -> None:
    assert states[-1, :2] == pytest.approx([run.surge_mps, run.sway_mps], abs=2e-5)
    assert math.degrees(states[-1, rate]) == pytest.approx(run.rate_degps, abs=2e-3)
    assert math.degrees(states[round(10 / dt_s), heading]) == pytest.approx(run.heading_10_s_deg, abs=0.05)


@pytest.mark.parametrize("number", range(len(RUNS["otter"])))
def test_the_otter(number: int) -> None:
    run = RUNS["otter"][number]
    shafts = [
        command * (otter.FASTEST_RADPS if command > 0 else otter.FASTEST_ASTERN_RADPS) for command in run.commands
    ]
    assert_same(run, Otter((shafts[0], shafts[1])).run(15.0, 0.1), 0.1, 5, 11)


@pytest.mark.medium
@pytest.mark.parametrize("number", range(len(RUNS["wamv16"])))
def test_the_wam_v(number: int) -> None:
    run = RUNS["wamv16"][number]
    thrusts = [math.copysign(command**2 * wamv.MOST_N, command) for command in run.commands]
    assert_same(run, WamV((thrusts[0], thrusts[1])).run(15.0, 0.1), 0.1, 5, 11)


@pytest.mark.parametrize("number", range(len(RUNS["cybership2"])))
def test_the_cybership_ii(number: int) -> None:
    run = RUNS["cybership2"][number]
    shafts = (run.commands[0] * 2000 / 60, run.commands[1] * 2000 / 60)
    assert_same(run, CyberShip2(shafts).run(15.0, dt_s=0.1), 0.1, 2, 5)
