"""A real ArduPilot Rover has every name of our parameter files, holds every value, and takes our standard messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from agent.wire import dialect
from sim_core.sensors.gnss import GnssSample
from sim_core.sensors.rangefinder import RangefinderSample
from sim_core.sensors.spec import RangefinderSpec
from tests.ardupilot import Rover
from tests.patience import PATIENCE_S
from xitl_cli.run.links.setup import parameter_file_values
from xitl_cli.run.sensors import sensor_messages as standard_messages

pytestmark = [pytest.mark.ardupilot, pytest.mark.slow]
COMBINATIONS = {
    "two propellers": ("rover-json", "rover-differential", "rover-asv-full", "rover-echo-sounder", "rover-wind-vane"),
    "a third of the size": ("rover-json", "rover-differential", "rover-asv-third"),
    "steered": ("rover-json", "rover-steered", "rover-asv-steered"),
    "vectornav": ("rover-vectornav", "rover-differential", "rover-asv-full"),
    "microstrain": ("rover-microstrain7", "rover-differential", "rover-asv-full"),
    "script": ("rover-hil", "rover-differential", "rover-asv-full"),
}
RANGEFINDER = RangefinderSpec(min_range_m=0.3, max_range_m=50.0)
LAT_DEG, LON_DEG, ALT_M = -8.79, -63.94, 71.0


@contextmanager
def connected(directory: Path, values: dict[str, float]) -> Iterator[Any]:
    """A ground station's connection to a Rover that has started with these values."""
    with Rover(directory, values) as rover:
        link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{rover.port}", source_system=255, source_component=190)
        try:
            assert link.wait_heartbeat(timeout=PATIENCE_S) is not None, rover.console
            yield link
        finally:
            link.close()


def values_held(link: Any, names: list[str]) -> dict[str, float]:
    """What it answers when asked for each by name; asked again a few times where it does not."""
    held: dict[str, float] = {}
    for _ in range(4):
        for name in names:
            if name in held:
                continue
            link.mav.param_request_read_send(1, 1, name.encode(), -1)
            while (answer := link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.3)) is not None:
                held[answer.param_id] = answer.param_value
                if answer.param_id == name:
                    break
    return held


@pytest.mark.parametrize("files", COMBINATIONS.values(), ids=COMBINATIONS.keys())
def test_it_has_every_name_and_holds_every_value(tmp_path: Path, files: tuple[str, ...]) -> None:
    values = parameter_file_values(files)
    values.pop("EAHRS_TYPE", None)  # with it, a start waits for the unit
    with connected(tmp_path, values) as link:
        held = values_held(link, list(values))
    assert sorted(values.keys() - held.keys()) == []
    other = {
        name: (value, held[name])
        for name, value in values.items()
        if not math.isclose(value, held[name], rel_tol=1e-6, abs_tol=1e-6)
        and not name.endswith("_ID")  # it notes there which units it has found
    }
    assert other == {}


def heard(link: Any, send: Callable[[int], list[Any]], name: str, fits: Callable[[Any], bool]) -> Any:
    """Send five times a second until a message of this name fits; None when none did."""
    ours = dialect.MAVLink(None, 255, 190)
    ends_s = time.monotonic() + PATIENCE_S
    number = 0
    while time.monotonic() < ends_s:
        number += 1
        for message in send(number * 200_000):
            link.write(message.pack(ours))
        answer = link.recv_match(type=name, blocking=True, timeout=0.2)
        if answer is not None and fits(answer):
            return answer
    return None


def test_gps_input_is_a_fix_where_it_says(tmp_path: Path) -> None:
    encode = standard_messages.gps_input(0)
    one = np.ones(1)
    sample = GnssSample(
        LAT_DEG * one,
        LON_DEG * one,
        ALT_M * one,
        np.zeros((1, 3)),
        0.5 * one,
        1.0 * one,
        0.1 * one,
        np.array([3]),
        np.array([14]),
    )
    with connected(tmp_path, {"GPS1_TYPE": 14}) as link:
        link.mav.command_long_send(1, 1, 511, 0, common.MAVLINK_MSG_ID_GPS_RAW_INT, 100_000, 0, 0, 0, 0, 0)
        fix = heard(link, lambda us: [encode(us, sample)], "GPS_RAW_INT", lambda fix: fix.fix_type >= 3)
    assert fix is not None
    assert (fix.lat, fix.lon) == (round(LAT_DEG * 1e7), round(LON_DEG * 1e7))
    assert (fix.alt, fix.satellites_visible) == (71_000, 14)


def test_distance_sensor_is_a_rangefinder(tmp_path: Path) -> None:
    encode = standard_messages.distance_sensor(0, RANGEFINDER)
    sample = RangefinderSample(np.array([12.34]))
    parameters = {"RNGFND1_TYPE": 10, "RNGFND1_ORIENT": 25, "RNGFND1_MIN": 0.3, "RNGFND1_MAX": 50.0}
    with connected(tmp_path, parameters) as link:
        link.mav.command_long_send(1, 1, 511, 0, common.MAVLINK_MSG_ID_DISTANCE_SENSOR, 100_000, 0, 0, 0, 0, 0)
        told = heard(link, lambda us: [encode(us, sample)], "DISTANCE_SENSOR", lambda told: told.current_distance > 0)
    assert told is not None
    assert (told.current_distance, told.orientation) == (1234, 25)
