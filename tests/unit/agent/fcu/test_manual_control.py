"""Sticks: ArduPilot's mapping of pulse widths and of MANUAL_CONTROL, releases and time-outs."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.fcu.control.allocation import pulse_width_us
from agent.fcu.control.manual_control import NONE, ManualControl, Sticks
from agent.fcu.parameters import Parameters

SECOND = 1_000_000_000
IGNORE, RELEASE_HIGH = 65535, 65534


def manual(**parameters: float) -> ManualControl:
    return ManualControl(Parameters(parameters))


def override(sticks: ManualControl, now_ns: int = 0, **widths_us: int) -> str:
    return sticks.override(tuple(widths_us.get(f"c{n}", IGNORE) for n in range(1, 19)), now_ns)


@pytest.mark.parametrize(
    ("width_us", "deflection"),
    [(1500, 0.0), (1530, 0.0), (1470, 0.0), (1900, 1.0), (1100, -1.0), (2200, 1.0), (800, -1.0), (1715, 0.5)],
)
def test_widths_become_deflections_outside_of_the_dead_zone(width_us: int, deflection: float) -> None:
    """Trim 1500, 30 either side are dead: (1715 - 1530) / (1900 - 1530) is a half."""
    sticks = manual()
    assert override(sticks, c1=width_us) == ""
    assert sticks.sticks(0).steering == pytest.approx(deflection)
    assert sticks.sticks(0).throttle == 0.0


def test_mapping_trim_and_direction_are_the_parameters() -> None:
    sticks = manual(RCMAP_ROLL=4, RCMAP_THROTTLE=2, RC4_REVERSED=1, RC2_TRIM=1400, RC2_DZ=0, RC2_MIN=1000)
    override(sticks, c4=1900, c2=1200, c1=1900, c3=1900)
    assert sticks.sticks(0) == pytest.approx((-1.0, -0.5))
    texts = [problem.text for problem in sticks.problems(0)]
    assert texts == ["Roll (RC4) is not neutral", "Throttle (RC2) is not neutral"]


def test_overrides_are_released_ignored_and_age() -> None:
    sticks = manual()
    override(sticks, 0, c1=1900, c3=1700, c9=1234)
    assert sticks.widths_us(0) == (1900, 0, 1700, 0, 0, 0, 0, 0, 1234, *NONE[9:])
    override(sticks, SECOND, c1=0, c3=IGNORE, c9=0)  # from channel 9 on, 0 leaves alone
    assert sticks.widths_us(SECOND)[:9] == (0, 0, 1700, 0, 0, 0, 0, 0, 1234)
    override(sticks, SECOND, c9=RELEASE_HIGH)
    assert sticks.widths_us(SECOND)[8] == 0
    assert sticks.widths_us(3 * SECOND - 1)[2] == 1700
    assert sticks.widths_us(3 * SECOND) == NONE
    assert sticks.sticks(3 * SECOND) == Sticks()


@pytest.mark.parametrize(("lasts_s", "after_s", "there"), [(0.0, 0, False), (-1.0, 10**6, True), (10.0, 9, True)])
def test_override_time(lasts_s: float, after_s: int, there: bool) -> None:
    sticks = manual(RC_OVERRIDE_TIME=lasts_s)
    override(sticks, c1=1900)
    assert (sticks.widths_us(after_s * SECOND)[0] == 1900) is there


def test_a_clock_set_back_ends_an_override() -> None:
    sticks = manual()
    override(sticks, 5 * SECOND, c1=1900)
    assert sticks.widths_us(SECOND) == NONE


@pytest.mark.parametrize("width_us", [1, 799, 2201, 65533, -5])
def test_widths_that_are_none_are_refused_whole(width_us: int) -> None:
    sticks = manual()
    assert f"RC channel 2 at {width_us} us" in override(sticks, c1=1900, c2=width_us)
    assert sticks.widths_us(0) == NONE


def test_manual_control_spans_the_channels() -> None:
    sticks = manual(RC1_MIN=1000, RC1_MAX=2000)
    assert sticks.set_axes(1000, -1000, 0) == ""
    assert (sticks.widths_us(0)[0], sticks.widths_us(0)[2]) == (2000, 1101)
    assert sticks.set_axes(0, 500, 0) == ""
    assert (sticks.widths_us(0)[0], sticks.widths_us(0)[2]) == (1500, 1700)
    assert sticks.set_axes(None, None, 0) == ""
    assert sticks.widths_us(0) == NONE
    assert "manual control z = 1001" in sticks.set_axes(0, 1001, 0)


@pytest.mark.medium
@given(
    st.lists(st.integers(-70000, 70000), max_size=30),
    st.dictionaries(st.sampled_from(["RC1_MIN", "RC1_MAX", "RC1_TRIM", "RC1_DZ", "RC1_REVERSED"]), st.floats(0, 1)),
)
def test_any_widths_and_any_calibration_give_deflections(widths_us: list[int], parts: dict[str, float]) -> None:
    from agent.fcu.parameters import TABLE

    rows = {row.name: row for row in TABLE}
    sticks = manual(
        **{name: round(rows[name].low + part * (rows[name].high - rows[name].low)) for name, part in parts.items()}
    )
    sticks.override(tuple(widths_us), 0)
    assert all(abs(deflection) <= 1.0 for deflection in sticks.sticks(0))


def test_motor_commands_as_pulse_widths() -> None:
    assert [pulse_width_us(command) for command in (-1.0, -0.5, 0.0, 0.25, 1.0)] == [1100, 1300, 1500, 1600, 1900]
