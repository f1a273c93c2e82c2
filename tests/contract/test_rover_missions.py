"""Mission items against a real ArduRover: what it took and refused, and how it gave them back, recorded from one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from agent.fcu.control.guidance import GuidanceGains, GuidanceInput
from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mission import MissionItem, make_mission
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle.mission_progress import MissionProgress
from agent.navigation.geodetic import LocalProjection
from agent.wire import dialect as mav

CAPTURES = Path(__file__).parents[1] / "data" / "captures"
CASES = json.loads((CAPTURES / "rover-mission-items.json").read_text())
HOME = [0, 16, [0.0, 0.0, 0.0, 0.0], -88000000, -639500000, 50.0]
LAST = [6, 20, [0.0, 0.0, 0.0, 0.0], 0, 0, 0.0]
_UNUSED_NAN = {(16, 2), (16, 3), (178, 3), (178, 4)}  # refused by ArduRover although the parameter does not count


def sent(message: Any) -> Any:
    message.get_header().srcSystem, message.get_header().srcComponent = 255, 190
    return message


def uploaded(channel: MavlinkChannel, items: list[Any]) -> int:
    (reply,) = channel.handle(sent(mav.MAVLink_mission_count_message(1, 1, len(items))), 0)
    for seq, (frame, command, parameters, x, y, z, *_) in enumerate(items):
        values = [*map(float, parameters), x, y, float(z)]
        item = mav.MAVLink_mission_item_int_message(1, 1, seq, frame, command, 0, 1, *values)
        (reply,) = channel.handle(sent(item), 0)
        if reply.get_type() == "MISSION_ACK":
            break
    return int(reply.type)


def named(case: list[Any]) -> str:
    return f"{case[1]} in frame {case[0]} with {case[2]}"


@pytest.mark.parametrize("case", CASES, ids=named)
def test_an_item_is_taken_or_refused_as_by_ardurover_and_given_back_whole(case: list[Any]) -> None:
    channel = MavlinkChannel(Autopilot())
    command, parameters, x, y, z, answer, theirs = case[1:]
    result = uploaded(channel, [HOME, case, LAST])
    nan_at = next((at for at, value in enumerate(map(float, parameters), start=1) if math.isnan(value)), 0)
    if (command, nan_at) in _UNUSED_NAN:
        assert result == mav.MAV_MISSION_ACCEPTED
        return
    assert result == answer
    if theirs is None:
        return
    (back,) = channel.handle(sent(mav.MAVLink_mission_request_int_message(1, 1, 1)), 0)
    ours = [back.param1, back.param2, back.param3, back.param4]
    assert (back.command, back.x, back.y, back.z) == (command, x, y, z)
    assert [str(value) for value in ours] == [str(float(value)) for value in parameters]
    if theirs[2] or theirs[3]:  # ArduRover keeps the frame of an item with a place alone
        assert back.frame == theirs[0] or command in (202, 203, 1000, 42702, 42703)


def test_the_float_form_is_given_back_the_same() -> None:
    channel = MavlinkChannel(Autopilot())
    items = [(3, 18, (2.0, 0.0, -20.0, 1.0), -8.79, -63.94, 0.0), (3, 203, (1.0, 2.0, 3.0, 4.0), 1.0, 7.0, 0.0)]
    channel.handle(sent(mav.MAVLink_mission_count_message(1, 1, 3)), 0)
    channel.handle(sent(mav.MAVLink_mission_item_message(1, 1, 0, 0, 16, 0, 1, 0, 0, 0, 0, -8.8, -63.95, 0)), 0)
    for seq, (frame, command, parameters, *place) in enumerate(items, start=1):
        message = mav.MAVLink_mission_item_message(1, 1, seq, frame, command, 0, 1, *parameters, *place)
        channel.handle(sent(message), 0)
    for seq, (frame, command, parameters, *place) in enumerate(items, start=1):
        (back,) = channel.handle(sent(mav.MAVLink_mission_request_message(1, 1, seq)), 0)
        assert (back.frame, back.command, back.x, back.y, back.z) == (frame, command, *place)
        assert (back.param1, back.param2, back.param3, back.param4) == parameters


def test_a_mission_goes_on_and_is_told_as_by_ardurover() -> None:
    """Texts of what is begun in their order, and the items that MISSION_CURRENT names."""
    recorded = json.loads((CAPTURES / "rover-mission-run.json").read_text())
    theirs = [text for kind, *_, text in recorded["seen"] if kind == "text"]
    current = [seq for kind, *_, seq in recorded["seen"] if kind == "cur" and seq > 0]
    frame = LocalProjection(-8.8, -63.95, 50.0)
    items = [
        MissionItem(command, x / 1e7, y / 1e7, z, tuple(parameters), 3)
        for _, command, parameters, x, y, z in recorded["items"]
    ]
    said: list[str] = []
    stages: list[int] = []
    progress = MissionProgress(make_mission(items), 2.0, lambda _, text: said.append(text))
    gains, place, yaw_rad, speed_mps = GuidanceGains.from_parameters(Parameters()), (0.0, 0.0), 0.0, 0.0
    while len(stages) < len(current) and len(said) < 100:
        stages += [progress.current] if stages[-1:] != [progress.current] else []
        output = progress.steer(GuidanceInput(gains, frame, place, yaw_rad, speed_mps, 0.0, 0.1))
        assert output is not None
        yaw_rad, speed_mps = output.heading_rad, output.speed_mps
        step_m = 0.1 * speed_mps
        place = (place[0] + step_m * math.cos(yaw_rad), place[1] + step_m * math.sin(yaw_rad))
    progress.steer(GuidanceInput(gains, frame, place, yaw_rad, speed_mps, 0.0, 0.1))
    assert stages == current
    # Ours say besides what was left out, the new speed (theirs was refused it while it waited) and the circle's bounds.
    own = ("Skipping", "speed:", "Circle:")
    assert [text for text in said if not text.startswith(own)] == theirs
