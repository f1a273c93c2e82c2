"""From pulse widths to commands in time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sim_core.vessel.spec import Hull, Propeller, Rudder, SteeringGear, VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.agents import ReplaySpec, ScriptStep
from xitl_cli.replay.motor_schedule import MotorSchedule, schedule_from_pulses, schedule_from_script
from xitl_cli.replay.pulse_log import PulseLog

SCREW = Propeller((-1.0, 0.0, 0.2), 50.0, 30.0)
HULL = Hull(length_m=2.0, width_m=1.5, radius_m=0.2, keel_below_cg_m=0.2)
PAIR = VesselSpec(name="pair", mass_kg=100.0, inertia_kgm2=(9.0, 9.0, 9.0), hull=HULL, propellers=(SCREW, SCREW))
STEERED = replace(PAIR, propellers=(replace(SCREW, steering=SteeringGear(45.0, 60.0)),))
RUDDER = Rudder(position_frd_m=(-1.2, 0.0, 0.2), area_m2=0.02, aspect_ratio=1.5)
RUDDERS = replace(PAIR, propellers=(SCREW,), rudders=(RUDDER, RUDDER))


def _log(**given: object) -> PulseLog:
    values: dict[str, object] = {
        "source": "pool.csv",
        "at_s": (10.0, 11.0, 12.5, 14.0),
        "pulses_us": {1: (1500.0, 1500.0, 1900.0, 1300.0), 3: (0.0, 1500.0, 1700.0, 2200.0)},
    }
    return PulseLog(**{**values, **given})  # type: ignore[arg-type]


def test_a_command_is_in_force_until_the_next() -> None:
    schedule = MotorSchedule((0, 1_000), ((0.1, 0.2), (0.3, 0.4)), 5_000)
    assert schedule.motors_at(-1) is None
    assert schedule.motors_at(0) == schedule.motors_at(999) == (0.1, 0.2)
    assert schedule.motors_at(1_000) == schedule.motors_at(10**12) == (0.3, 0.4)


def test_pulses_are_taken_from_trim_and_span_and_limited() -> None:
    schedule = schedule_from_pulses(_log(), ReplaySpec(start_s=10.0), PAIR)
    assert schedule.motors == ((0.0, 0.0), (0.0, 0.0), (1.0, 0.5), (-0.5, 1.0))
    assert schedule.at_ns == (0, 1_000_000_000, 2_500_000_000, 4_000_000_000)
    assert schedule.end_ns == schedule.last_ns == 4_000_000_000
    half = schedule_from_pulses(_log(), ReplaySpec(start_s=10.0, trim_us=1600, span_us=800), PAIR)
    assert half.motors[2] == (0.375, 0.125)


def test_it_starts_at_the_first_armed_output_unless_told_otherwise() -> None:
    left_neutral = schedule_from_pulses(_log(), ReplaySpec(), PAIR)
    assert left_neutral.at_ns[0] == 0
    assert left_neutral.motors[0] == (1.0, 0.5)
    assert left_neutral.end_ns == 1_500_000_000
    armed = schedule_from_pulses(_log(armed_s=10.5), ReplaySpec(), PAIR)
    assert armed.motors[0] == (0.0, 0.0)
    assert armed.end_ns == 3_000_000_000


def test_a_start_between_two_outputs_has_the_earlier_one_in_force_at_once() -> None:
    schedule = schedule_from_pulses(_log(), ReplaySpec(start_s=13.0, end_s=13.5), PAIR)
    assert schedule.at_ns == (0,)
    assert schedule.motors == ((1.0, 0.5),)
    assert schedule.end_ns == 500_000_000
    before = schedule_from_pulses(_log(), ReplaySpec(start_s=9.0), PAIR)
    assert before.motors_at(999_999_999) is None
    assert before.motors_at(1_000_000_000) == (0.0, 0.0)


def test_steering_and_throttle_are_mixed_as_for_skid_steering() -> None:
    # steering 0, 0, 1, -0.5; throttle 0, 0, 0.5, 1 (2200 is beyond the span)
    schedule = schedule_from_pulses(
        _log(), ReplaySpec(start_s=10.0, outputs_are="steering-throttle", outputs=(1, 3)), PAIR
    )
    assert schedule.motors[:2] == ((0.0, 0.0), (0.0, 0.0))
    assert schedule.motors[2] == pytest.approx((1.0, -1 / 3))  # 1.5 and -0.5, shrunk alike
    assert schedule.motors[3] == pytest.approx((1 / 3, 1.0))


@pytest.mark.parametrize(("vessel", "motors"), [(STEERED, (0.5, 1.0)), (RUDDERS, (0.5, 1.0, 1.0))])
def test_steering_and_throttle_go_to_what_steers_as_they_are(vessel: VesselSpec, motors: tuple[float, ...]) -> None:
    """Of an ArduRover with a rudder: output 1 is its steering, 3 its throttle."""
    for log in (_log(functions={1: 26, 3: 70}), _log()):
        replay = ReplaySpec(outputs_are=None if log.functions else "steering-throttle")
        assert schedule_from_pulses(log, replay, vessel).motors[0] == pytest.approx(motors)


def test_any_other_vessel_has_its_outputs_from_one_on() -> None:
    pulses = {1: (1500.0, 1900.0), 2: (1700.0, 1700.0), 3: (1300.0, 1300.0)}
    log = _log(at_s=(0.0, 1.0), pulses_us=pulses)
    assert schedule_from_pulses(log, ReplaySpec(), RUDDERS).motors == ((0.0, 0.5, -0.5), (1.0, 0.5, -0.5))


@pytest.mark.parametrize(
    ("functions", "motors"),
    [
        ({1: 73, 3: 74}, (1.0, 0.5)),
        ({1: 74, 3: 73}, (0.5, 1.0)),
        ({1: 26, 3: 70}, (1.0, -1 / 3)),
        ({1: 0, 3: 0}, (1.0, 0.5)),
    ],
)
def test_a_log_says_itself_what_its_outputs_are(functions: dict[int, int], motors: tuple[float, float]) -> None:
    assert schedule_from_pulses(_log(functions=functions), ReplaySpec(), PAIR).motors[0] == pytest.approx(motors)


def test_told_outputs_win_over_what_the_log_says() -> None:
    told = ReplaySpec(outputs=(3, 1))
    assert schedule_from_pulses(_log(functions={1: 73, 3: 74}), told, PAIR).motors[0] == (0.5, 1.0)


@pytest.mark.parametrize(
    ("replay", "words"),
    [
        (ReplaySpec(outputs=(1, 2)), ("has no output C2", "only C1, C3", "driver.replay.outputs")),
        (ReplaySpec(start_s=20.0), ("ends at 14 s, not after the start of the replay at 20 s", "from 10 to 14 s")),
        (ReplaySpec(start_s=10.0, end_s=2.0), ("ends at 2 s",)),
    ],
)
def test_what_cannot_be_played_is_named(replay: ReplaySpec, words: tuple[str, ...]) -> None:
    with pytest.raises(UserError) as caught:
        schedule_from_pulses(_log(), replay, PAIR)
    assert str(caught.value).startswith("pool.csv ")
    for word in words:
        assert word in str(caught.value)


def test_outputs_that_never_leave_neutral_have_no_start() -> None:
    still = _log(pulses_us={1: (1500.0,) * 4, 3: (0.0,) * 4})
    with pytest.raises(UserError, match="all outputs stay at 1500 µs"):
        schedule_from_pulses(still, ReplaySpec(), PAIR)
    assert schedule_from_pulses(still, ReplaySpec(start_s=10.0), PAIR).motors[0] == (0.0, 0.0)


def test_a_script_ends_where_it_says_and_else_holds_its_last_step() -> None:
    steps = (ScriptStep(at_s=0.0, motors=(0.5, 0.4)), ScriptStep(at_s=3.0, motors=(0.0, 0.0)))
    held = schedule_from_script(steps)
    assert held.end_ns is None
    assert held.last_ns == 3_000_000_000
    ended = schedule_from_script((*steps, ScriptStep(at_s=5.0, end=True)))
    assert ended.end_ns == ended.last_ns == 5_000_000_000
    assert ended.motors == held.motors
