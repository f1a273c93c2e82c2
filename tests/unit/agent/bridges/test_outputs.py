"""Pulse widths to commands."""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

from agent.bridges.counts import BridgeCounts
from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.role import MotorOutputs, actuators_message, updated_pulses_us
from agent.wire import dialect as mav

US = [1900, 1100, 1300, 0, 2200, 700, 1500, 1501]


@pytest.mark.parametrize(
    ("channels", "wanted"),
    [((1, 3), (1.0, -0.5)), ((3, 1), (-0.5, 1.0)), ((4,), (0.0,)), ((5, 6), (1.0, -1.0)), ((8, 9), (0.0025, 0.0))],
)
def test_commands_of_pulses(channels: tuple[int, ...], wanted: tuple[float, ...]) -> None:
    assert MotorOutputs(channels).commands_from_pulses(US) == pytest.approx(wanted)


def test_trim_and_span_are_the_profiles() -> None:
    outputs = MotorOutputs((1, 2), trim_us=1450.0, span_us=500.0)
    assert outputs.commands_from_pulses([1700, 1200]) == pytest.approx((0.5, -0.5))


def test_nothing_heard_commands_nothing() -> None:
    assert MotorOutputs((1, 3)).commands_from_pulses(()) == (0.0, 0.0)


def test_normalised_outputs_are_limited() -> None:
    assert MotorOutputs((2, 1, 5)).commands_from_values([0.25, -3.0]) == (-1.0, 0.25, 0.0)


def test_a_normalised_output_that_is_not_finite_commands_nothing() -> None:
    assert MotorOutputs((1, 2)).commands_from_values([math.nan, math.inf]) == (0.0, 0.0)


def servo(port: int, *pulses: int) -> mav.MAVLink_servo_output_raw_message:
    return mav.MAVLink_servo_output_raw_message(0, port, *pulses, *(0,) * (16 - len(pulses)))


def test_the_second_set_of_outputs_is_behind_the_first() -> None:
    first = updated_pulses_us(servo(0, 1500, 1600), ())
    assert (len(first), first[:2]) == (16, (1500, 1600))
    both = updated_pulses_us(servo(1, 1900), first)
    assert (len(both), both[:2], both[16]) == (32, (1500, 1600), 1900)
    assert updated_pulses_us(servo(0, 1510), both)[16] == 1900
    assert updated_pulses_us(servo(1, 1900), ())[16] == 1900
    assert updated_pulses_us(servo(7, 1900), both) == both


def test_on_the_wire() -> None:
    message = actuators_message((0.5, -0.5), True, 11, 12, 13_000, 14)
    assert (message.time_usec, message.imu_time_usec, message.imu_receive_usec, message.tick) == (13, 11, 12, 14)
    assert (message.count, message.flags, list(message.command)) == (2, 1, [0.5, -0.5] + [0.0] * 6)
    assert len(actuators_message((0.1,) * 12, False, 0, 0, 0, 0).command) == 8


def test_an_injector_that_takes_nothing_lets_the_autopilot_run() -> None:
    """The defaults of the interface: no outputs, nothing to wait for, nothing counted."""
    injector, counts = Injector(), InjectorCounters()
    injector.repeat(1)
    injector.serve(1)
    assert injector.advance(1)
    assert injector.run_on(1)
    assert (injector.pulses(), injector.commands()) == (None, None)
    assert (tuple(injector.descriptors()), injector.addresses) == ((), ())
    injector.close()
    assert not any(getattr(counts, count.name) for count in fields(counts))


def test_counts_of_several_injectors_add_up_but_their_rate_is_the_highest() -> None:
    parts = [BridgeCounts(imu_out=3, unsent=1, world_rate=400), BridgeCounts(imu_out=4, junk=7, world_rate=1200)]
    total = BridgeCounts.total(parts)
    assert total == BridgeCounts(imu_out=7, unsent=1, junk=7, world_rate=1200)
    assert BridgeCounts.total([]) == BridgeCounts()


def test_a_count_beyond_its_type_is_the_largest_of_the_type() -> None:
    counts = BridgeCounts(imu_out=2**32, unsent=2**32 - 1, world_rate=65536, connected=256)
    on_wire = counts.on_wire()
    assert (on_wire["imu_out"], on_wire["unsent"]) == (2**32 - 1, 2**32 - 1)
    assert (on_wire["world_rate"], on_wire["connected"], on_wire["junk"]) == (65535, 255, 0)
    message = mav.MAVLink_xitl_bridge_status_message(0, **on_wire)
    assert BridgeCounts.of_message(message) == BridgeCounts(**on_wire)
