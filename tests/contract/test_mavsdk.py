"""MAVSDK against a boat in real time: it knows this vehicle as an ArduPilot rover and gets no special treatment."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest
from live_boat import Boat, boat

from tests.patience import PATIENCE_S

pytest.importorskip("mavsdk", reason="MAVSDK is not installed: pip install mavsdk")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionItem, MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

pytestmark = pytest.mark.slow
DEG_PER_M = 1.0 / 110_600.0


async def until(values: AsyncIterator[Any], wanted: Callable[[Any], bool], timeout_s: float = PATIENCE_S) -> Any:
    async def look() -> Any:
        async for value in values:
            if wanted(value):
                return value
        raise AssertionError("MAVSDK ended the subscription")

    return await asyncio.wait_for(look(), timeout_s)


def with_system(found: Boat, do: Callable[[Any], Awaitable[None]]) -> None:
    async def run() -> None:
        config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        async with Mavsdk(config) as sdk:
            await sdk.add_any_connection(f"udpin://127.0.0.1:{found.udp_ports[0]}")
            system = await sdk.first_autopilot(timeout_s=PATIENCE_S)
            assert system is not None
            await do(system)

    asyncio.run(run())


def waypoint(seq: int, x: int, y: int) -> Any:
    frame, command = 6, 16
    return MissionItem(seq, frame, command, int(seq == 1), 1, 0.0, 0.0, 0.0, math.nan, x, y, 0.0, 0)


def item(seq: int, frame: int, command: int, parameters: tuple[float, ...], x: int, y: int) -> Any:
    return MissionItem(seq, frame, command, int(seq == 1), 1, *parameters, x, y, 0.0, 0)


def items_of_a_survey(place: tuple[int, int]) -> list[Any]:
    """Frame, command, parameters and place of items that need devices, wait, turn or jump."""
    return [
        (3, 206, (5.0, 0.0, 1.0, 0.0), 0, 0),
        (3, 16, (0.0, 0.0, 0.0, 0.0), *place),
        (3, 114, (8.0, 0.0, 0.0, 0.0), 0, 0),
        (3, 183, (5.0, 1700.0, 0.0, 0.0), 0, 0),
        (10, 18, (2.0, 0.0, -12.0, 1.0), *place),
        (3, 201, (3.0, 0.0, 0.0, 0.0), *place),
        (3, 194, (1.0, 0.0, 0.0, 0.0), 0, 0),
        (3, 93, (20.0, -1.0, -1.0, -1.0), 0, 0),
        (3, 178, (1.0, -1.0, -1.0, 0.0), 0, 0),
        (3, 177, (2.0, 3.0, 0.0, 0.0), 0, 0),
        (3, 20, (0.0, 0.0, 0.0, 0.0), 0, 0),
    ]


def fields_of(one: Any) -> tuple[Any, ...]:
    return one.frame, one.command, one.param1, one.param2, one.param3, one.param4, one.x, one.y, one.z


def test_connect_see_set_and_fly_a_mission() -> None:
    with boat() as found:
        with_system(found, fly)


async def fly(system: Any) -> None:
    telemetry, action = TelemetryAsync(system), ActionAsync(system)
    await telemetry.set_rate_position(4)
    health = await until(telemetry.subscribe_health(), lambda seen: seen.is_armable)
    assert health.is_global_position_ok
    assert health.is_home_position_ok
    assert health.is_gyrometer_calibration_ok
    start = await telemetry.position()
    assert start.latitude_deg == pytest.approx(-8.8, abs=0.01)
    attitude = await telemetry.attitude_euler()
    assert abs(attitude.roll_deg) < 5.0
    assert abs(attitude.pitch_deg) < 5.0

    parameters = ParamAsync(system)
    assert await parameters.get_param_float("WP_SPEED") == 3.0
    await parameters.set_param_float("WP_SPEED", 2.5)
    assert await parameters.get_param_float("WP_SPEED") == 2.5
    with pytest.raises(Exception, match=r"(?i)param|value|denied|timeout"):
        await parameters.set_param_float("WP_SPEDE", 1.0)

    # Item 0 is home with ArduPilot; MAVSDK's Mission does not know that, its MissionRaw leaves it to the user.
    mission = MissionRawAsync(system)
    here = (round(start.latitude_deg * 1e7), round(start.longitude_deg * 1e7))
    there = [(here[0] + round(north_m * DEG_PER_M * 1e7), here[1]) for north_m in (15.0, 30.0)]
    home = waypoint(0, *here)
    rich = [home, *(item(seq, *fields) for seq, fields in enumerate(items_of_a_survey(there[0]), start=1))]
    await asyncio.wait_for(mission.upload_mission(rich), PATIENCE_S)
    back = await asyncio.wait_for(mission.download_mission(), PATIENCE_S)
    assert [fields_of(one) for one in back[1:]] == [fields_of(one) for one in rich[1:]]

    plan = [waypoint(seq, *place) for seq, place in enumerate([here, *there])]
    await asyncio.wait_for(mission.upload_mission(plan), PATIENCE_S)
    back = await asyncio.wait_for(mission.download_mission(), PATIENCE_S)
    assert [(item.x, item.y) for item in back[1:]] == there

    await action.arm()
    await until(telemetry.subscribe_armed(), bool)
    await mission.start_mission()
    await until(mission.subscribe_mission_progress(), lambda seen: 0 < seen.total == seen.current, 90.0)
    place = await telemetry.position()
    assert abs(place.latitude_deg - there[1][0] / 1e7) < 5.0 * DEG_PER_M

    before = await telemetry.flight_mode()
    await action.return_to_launch()
    returning = await until(telemetry.subscribe_flight_mode(), lambda mode: mode != before)
    assert "RETURN" in returning.name
    await action.disarm()
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
