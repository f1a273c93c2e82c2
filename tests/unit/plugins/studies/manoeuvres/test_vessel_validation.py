"""The validation of vessels: each figure against its reference, and against the curve that its plot shows."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec
from xitl_cli.logs.model.sections import Plot
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, ReferenceKind, Source
from xitl_cli.plugins.studies.manoeuvres.trials import SpiralOrder, TurnOrder, ZigZagOrder
from xitl_cli.plugins.studies.manoeuvres.validation import (
    ARCHIMEDES,
    HORIZONTAL,
    LINEAR,
    LOITER,
    LONG_WAVES,
    MIRRORED,
    PANEL_CODE,
    STRIPS,
    SURGE_ALONE,
    ValidatedFigure,
    Validation,
    validate_vessel,
)
from xitl_cli.profile import load_profile

TELLS: dict[str, list[str]] = {}


def vessel(name: str) -> VesselSpec:
    model = load_profile(f"vehicles/{name}").vehicle
    assert model is not None
    return model


@cache
def validated(name: str) -> Validation:
    return validate_vessel(vessel(name), name, tell=TELLS.setdefault(name, []).append)


def values(name: str) -> dict[str, float | None]:
    return {figure.key: figure.value for figure in validated(name).figures}


def value(name: str, key: str) -> float:
    found = values(name)[key]
    assert found is not None
    return found


def plot(name: str, key: str) -> Plot:
    return next(one for section in validated(name).sections for one in section.plots if one.key == key)


def curve(name: str, key: str, trace: int = 0) -> tuple[Array, Array]:
    found = plot(name, key).traces[trace]
    return np.asarray(found.x, dtype=float), np.asarray(found.y, dtype=float)


def compared(name: str, source: Source) -> list[ValidatedFigure]:
    return [one for one in validated(name).figures if one.reference is not None and one.reference.source == source]


@pytest.mark.medium
def test_a_catamaran_agrees_with_every_reference() -> None:
    found = validated("asv-full")
    assert found.differing == ()
    assert found.steered_by == "difference of thrust"
    assert TELLS["asv-full"] == [
        "afloat",
        "acceleration",
        "turning circle at full steering",
        "zig-zag",
        "spiral",
        "crash stop and coasting",
        "free decays",
        "response to waves",
        "station keeping",
    ]
    assert len(compared("asv-full", HORIZONTAL)) == 7 + 5 + 4 + 3  # a turn, two zig-zags and three angles of the spiral
    assert len(compared("asv-full", PANEL_CODE)) == 4 * 8
    assert len(compared("asv-full", LINEAR)) == 3 * 2  # period and damping of heave, roll and pitch
    assert len(compared("asv-full", ARCHIMEDES)) == 4
    assert len(compared("asv-full", SURGE_ALONE)) == 3 + 2 * 2
    assert [one.key for one in compared("asv-full", LONG_WAVES)] == ["roll_beam_20"]
    assert [one.key for one in compared("asv-full", LOITER)] == ["station_radius_m"]
    (asymmetry,) = compared("asv-full", MIRRORED)
    assert asymmetry.value == pytest.approx(0.0, abs=1e-12)


@pytest.mark.medium
def test_the_turns_of_both_sides_are_mirrored() -> None:
    _, theory = (np.array(curve("asv-full", "turning", trace)) for trace in (0, 2))
    starboard, port = (np.array(curve("asv-full", "turning", trace)) for trace in (0, 1))
    assert port == pytest.approx(starboard * [[-1.0], [1.0]], abs=1e-9)
    assert theory[0].max() == pytest.approx(starboard[0].max(), rel=0.03)
    for key in ("advance_m", "transfer_m", "tactical_diameter_m", "speed_mps", "drift_deg"):
        assert value("asv-full", f"turn_port_{key}") == pytest.approx(value("asv-full", f"turn_starboard_{key}"))
    assert value("asv-full", "turn_port_rate_degps") == pytest.approx(-value("asv-full", "turn_starboard_rate_degps"))


@pytest.mark.medium
def test_the_turning_circle_ends_after_two_turns() -> None:
    east, north = curve("asv-full", "turning")
    course = np.unwrap(np.arctan2(np.diff(east), np.diff(north)))
    assert math.degrees(course[-1] - course[0]) == pytest.approx(720.0, abs=10.0)  # 2 degrees a sample, and the drift
    assert east[-1] - east[0] < 0.5 * value("asv-full", "turn_starboard_tactical_diameter_m")
    sizes_m = [value("asv-full", f"turn_starboard_{key}_m") for key in ("advance", "tactical_diameter")]
    assert [north.max() - north[0], east.max() - east[0]] == pytest.approx(sizes_m, rel=0.01)


@pytest.mark.medium
def test_the_acceleration_is_that_of_its_curve() -> None:
    time_s, full_mps = curve("asv-full", "acceleration")
    _, less_mps = curve("asv-full", "acceleration", 1)
    assert time_s[:3] == pytest.approx([0.0, 0.1, 0.2])
    assert value("asv-full", "top_speed_mps") == full_mps[-1]
    assert value("asv-full", "approach_speed_mps") == less_mps[-1] < full_mps[-1]
    assert value("asv-full", "time_to_95_percent_s") == pytest.approx(
        float(np.interp(0.95 * full_mps[-1], full_mps, time_s)), rel=1e-6
    )


@pytest.mark.medium
@pytest.mark.parametrize(("trace", "key", "left"), [(0, "crash_stop", 0.0), (1, "coasting", 0.1)])
def test_the_way_to_a_stop_is_the_integral_of_its_curve(trace: int, key: str, left: float) -> None:
    time_s, ahead_mps = curve("asv-full", "stopping", trace)
    assert ahead_mps[0] == value("asv-full", "approach_speed_mps")
    end_s = float(np.interp(-left * ahead_mps[0], -ahead_mps, time_s))
    assert value("asv-full", f"{key}_time_s") == pytest.approx(end_s, rel=1e-6)
    fine_s = np.linspace(0.0, end_s, 2000)
    way_m = float(np.trapezoid(np.interp(fine_s, time_s, ahead_mps), fine_s))
    assert value("asv-full", f"{key}_track_reach_m") == pytest.approx(way_m, rel=3e-3)


@pytest.mark.medium
def test_the_spiral_is_that_of_its_curves() -> None:
    angle_deg, down = curve("asv-full", "spiral")
    _, up = curve("asv-full", "spiral", 1)
    assert angle_deg.tolist() == [-20.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0]
    assert down == pytest.approx(-up[::-1], abs=1e-6)  # mirrored
    assert np.all(np.diff(down) > 1.0)
    assert value("asv-full", "spiral_loop_degps") == np.abs(down - up).max()
    assert value("asv-full", "spiral_at_zero_degps") == down[3]
    for index, angle in ((4, 5), (5, 10), (6, 20)):
        assert value("asv-full", f"spiral_at_{angle}_degps") == pytest.approx(down[index])


@pytest.mark.medium
@pytest.mark.parametrize("angle", [10, 20])
def test_a_zig_zag_is_reversed_at_its_angle(angle: int) -> None:
    time_s, heading_deg = curve("asv-full", f"zig_zag_{angle}")
    _, steering_deg = curve("asv-full", f"zig_zag_{angle}", 1)
    assert set(steering_deg) == {float(angle), -float(angle)}
    reversed_at = np.flatnonzero(np.diff(steering_deg)) + 1
    assert len(reversed_at) == 6
    assert reversed_at[-1] == len(time_s) - 1  # the last sample
    sides = np.array([1.0, -1.0] * 3)
    assert sides * heading_deg[reversed_at] == pytest.approx(np.full(6, angle), abs=0.4)
    first, second = (float(np.abs(heading_deg[a:b]).max()) for a, b in pairwise(reversed_at[:3]))
    at_reversal = np.abs(heading_deg[reversed_at[:2]])
    assert value("asv-full", f"zig_zag_{angle}_overshoot_1_deg") == pytest.approx(first - at_reversal[0])
    assert value("asv-full", f"zig_zag_{angle}_overshoot_2_deg") == pytest.approx(second - at_reversal[1])


@pytest.mark.medium
@pytest.mark.parametrize(("motion", "released"), [("heave", 0.05 * 0.1002), ("roll", 1.0), ("pitch", 1.0)])
def test_a_decay_is_that_of_its_curve(motion: str, released: float) -> None:
    """Crossings of zero are half a damped period apart."""
    time_s, deflection = curve("asv-full", f"decay_{motion}")
    assert abs(deflection[0]) == pytest.approx(released, rel=1e-3)
    crossings = np.flatnonzero(np.diff(np.sign(deflection)))[:4]
    at_s = [
        time_s[i] + (time_s[i + 1] - time_s[i]) * deflection[i] / (deflection[i] - deflection[i + 1]) for i in crossings
    ]
    ratio = value("asv-full", f"{motion}_damping_ratio")
    damped_s = 2.0 * float(np.diff(at_s)[1:].mean())
    assert value("asv-full", f"{motion}_period_s") == pytest.approx(damped_s * math.sqrt(1 - ratio**2), rel=0.02)
    assert time_s[-1] == pytest.approx(
        8.0 * max(value("asv-full", f"{one}_period_s") for one in ("heave", "roll", "pitch")), rel=0.03
    )


@pytest.mark.medium
def test_responses_are_those_of_their_curves() -> None:
    for name in ("heave_head", "pitch_head", "heave_beam", "roll_beam"):
        ratios, measured = curve("asv-full", name)
        _, theory = curve("asv-full", name, 1)
        assert ratios.tolist() == [1.2, 1.6, 2.2, 3.0, 4.5, 7.0, 12.0, 20.0]
        for ratio, size, expected in zip(ratios, measured, theory, strict=True):
            (figure, *_) = [one for one in validated("asv-full").figures if one.key == f"{name}_{ratio:g}"]
            assert figure.value == size
            assert figure.reference is not None
            assert figure.reference.value == expected


@pytest.mark.medium
def test_the_vessel_keeps_its_station_against_current_and_wind() -> None:
    """It drifts at first to the north-east, where current and wind go, and is then kept within its loiter radius."""
    east, north = curve("asv-full", "station")
    assert value("asv-full", "station_current_mps") == 0.42  # a tenth of the top speed of 4.22 m/s
    assert value("asv-full", "station_wind_mps") == 8.0
    assert len(east) == 1500  # a minute of cycles
    away_m = np.hypot(east, north)
    assert away_m[:300].max() > 4.0  # 12 s in 0.42 m/s, until it arms
    assert east[299] > 12.0 * 0.3
    assert north[299] > 0.1
    radius_m = value("asv-full", "station_radius_m")
    settled_m = away_m[749:]  # from the end of the cycle at 30 s
    assert np.mean(settled_m <= radius_m) == pytest.approx(0.95, abs=2.0 / len(settled_m))
    assert radius_m < 2.0


@pytest.mark.medium
def test_the_mariner_does_as_the_published_equations() -> None:
    found = validated("mariner")
    assert found.steered_by == "rudder"
    assert found.differing == ()
    assert TELLS["mariner"] == ["afloat", "manoeuvres of the table"]
    ship = {key for key in values("mariner") if key.startswith("ship_")}
    assert len(ship) == 2 * 4 + 2 * 2
    assert value("mariner", "ship_turn_port_rate_degps") < 0.0 < value("mariner", "ship_turn_starboard_rate_degps")
    for row, side in enumerate(("starboard", "port")):
        east, north = curve("mariner", "ship_turning", row)
        yaw = np.unwrap(np.arctan2(np.diff(east), np.diff(north)))
        assert np.sign(yaw[-1]) == (1.0, -1.0)[row]
        assert value("mariner", f"ship_turn_{side}_tactical") == pytest.approx(np.abs(east).max(), rel=0.02)
        assert value("mariner", f"ship_turn_{side}_advance") == pytest.approx(north.max(), rel=0.03)
    for angle in (10, 20):
        time_s, heading_deg = curve("mariner", f"ship_zig_zag_{angle}")
        assert time_s[-1] == pytest.approx(45.0 * vessel("mariner").length_m / 7.7175, abs=1.0)
        first_swing = slice(0, int(np.flatnonzero(heading_deg < 0.0)[0]))
        swing_deg = heading_deg[first_swing].max() - angle
        first_deg = value("mariner", f"ship_zig_zag_{angle}_first_deg")
        assert first_deg == pytest.approx(swing_deg, abs=0.3)  # the heading between two samples


@pytest.mark.medium
def test_the_tank_model_of_kvlcc2_does_as_published_but_for_disputed_overshoots() -> None:
    found = validated("kvlcc2-l7")
    assert found.differing == ()
    agreeing = [figure.key.partition("_")[0] for figure in found.figures if figure.agrees]
    assert agreeing.count("ship") == 2 * 2 + 2 + 4  # turns beside simulation and free run, to port, zig-zags
    disputed = [figure for figure in found.figures if figure.reference is not None and figure.reference.disputed]
    assert [figure.agrees for figure in disputed] == [None] * 4
    assert {figure.reference.source.kind for figure in disputed if figure.reference} == {ReferenceKind.MEASURED}


def test_a_ship_with_a_table_needs_the_speed_of_its_approach() -> None:
    unknown = replace(vessel("mariner"), cruise_speed_mps=None)
    ship = validate_vessel(unknown, "another").sections[-1]
    assert (ship.key, ship.facts) == ("ship", ())
    assert ship.lacks == ("give vehicle.cruise_speed_mps, the speed of the approach",)


@pytest.mark.medium
def test_published_runs_of_the_otter() -> None:
    found = validated("otter")
    assert found.differing == ()
    runs = {key: size for key, size in values("otter").items() if key.startswith("run_")}
    # Straight runs have no sway and no rate of turn to compare.
    assert sorted(runs) == sorted(
        [f"run_{run}_{figure}" for run in range(6) for figure in ("surge_mps", "heading_deg")]
        + [f"run_{run}_{figure}" for run in (1, 2, 3, 5) for figure in ("sway_mps", "rate_degps")]
    )
    figures = [figure for figure in found.figures if figure.key in runs]
    assert all(figure.agrees for figure in figures)
    allowed = {figure.key: figure.reference.allowed for figure in figures if figure.reference is not None}
    assert allowed["run_1_surge_mps"] == pytest.approx(0.03 * 2.23782)
    assert allowed["run_3_sway_mps"] == 1e-3  # 3 % of 0.01 m/s would be less than the digits
    assert allowed["run_2_rate_degps"] == pytest.approx(0.03 * 17.5072)
    assert allowed["run_0_heading_deg"] == 3.0
    east, north = curve("otter", "runs", 1)
    assert east[-1] > 0.0
    assert (east[0], north[0]) == (0.0, 0.0)


@pytest.mark.medium
def test_a_propeller_beside_its_place_turns_the_boat_better_to_one_side() -> None:
    """The starboard propeller is 0.4 of its place further out: a turn to port has the longer lever."""
    model = vessel("asv-full")
    port, starboard = model.propellers
    x, y, z = starboard.position_frd_m
    further = replace(starboard, position_frd_m=(x, 1.4 * y, z))
    lopsided = replace(model, propellers=(port, further), hydrodynamics_file=None)
    validation = validate_vessel(lopsided, "mine")
    found = {figure.key: figure for figure in validation.figures}
    # Without tables of a panel code, the reference in waves is strip theory.
    in_waves = [one for one in validation.figures if one.reference is not None and one.reference.source == STRIPS]
    assert [one.agrees for one in in_waves] == [True] * 4 * 8
    asymmetry = found["turn_asymmetry"]
    assert asymmetry.reference is None  # it is not built symmetric
    port_degps, starboard_degps = (found[f"turn_{side}_rate_degps"].value for side in ("port", "starboard"))
    assert port_degps is not None
    assert starboard_degps is not None
    assert asymmetry.value is not None
    assert -port_degps > 1.05 * starboard_degps
    assert asymmetry.value >= -port_degps / starboard_degps - 1.0


SOURCE = Source(ReferenceKind.PUBLISHED, "a paper")


def figure(found: float | None, unit: str = "m", **reference: object) -> ValidatedFigure:
    of = FigureReference(**({"value": 10.0, "allowed": 0.5, "source": SOURCE} | reference))  # type: ignore[arg-type]
    return ValidatedFigure("Turning", "key", "label", unit, found, of)


@pytest.mark.parametrize(
    ("found", "reference", "agrees"),
    [
        (10.5, {}, True),
        (9.5, {}, True),
        (10.6, {}, False),
        (9.4, {}, False),
        (None, {}, False),
        (0.0, {"at_most": True}, True),
        (10.5, {"at_most": True}, True),
        (10.6, {"at_most": True}, False),
        (99.0, {"disputed": "the sources differ"}, None),
    ],
)
def test_a_figure_agrees_within_its_tolerance(found: float | None, reference: dict[str, object], agrees: bool) -> None:
    one = figure(found, **reference)
    assert one.agrees is agrees
    assert Validation("boat", "rudder", (), (one,)).differing == ((one,) if agrees is False else ())


def test_a_figure_without_a_reference_neither_agrees_nor_differs() -> None:
    one = ValidatedFigure("Turning", "key", "label", "m", 1.0, None)
    assert (one.error, one.agrees, one.error_text) == (None, None, "")


@pytest.mark.parametrize(
    ("one", "text"),
    [
        (figure(11.0), "+10.0 %"),
        (figure(-11.0, value=-10.0), "-10.0 %"),
        (figure(9.0, "s"), "-10.0 %"),
        (figure(11.25, "deg"), "+1.25 deg"),
        (figure(10.1256, ""), "+0.126"),
        (figure(0.5, value=0.0), "+0.50 m"),
        (figure(10.0, at_most=True), "within"),
        (figure(11.0, at_most=True), "+10.0 %"),
        (figure(None), ""),
    ],
)
def test_an_error_is_a_share_of_the_reference_where_it_means_something(one: ValidatedFigure, text: str) -> None:
    assert one.error_text == text


def test_a_turn_is_ordered_until_two_full_turns_to_either_side() -> None:
    for angle in (35.0, -35.0):
        order = TurnOrder(angle)
        assert [order.steering(0.0, turned) for turned in (0.0, 719.9, -719.9)] == [angle] * 3
        assert not order.done
        order.steering(1.0, math.copysign(720.0, angle))
        order.steering(2.0, 719.0)
        assert order.done


def test_a_zig_zag_is_ordered_until_the_sixth_reversal() -> None:
    order = ZigZagOrder(10.0)
    assert order.steering(0.0, 0.0) == order.steering(1.0, 9.9) == 10.0
    assert order.steering(2.0, 10.0) == order.steering(3.0, 14.0) == order.steering(4.0, -9.9) == -10.0
    for turned, side in ((-10.0, 1.0), (10.0, -1.0), (-10.0, 1.0), (10.0, -1.0)):
        assert not order.done
        assert order.steering(5.0, turned) == 10.0 * side
    assert not order.done
    assert order.steering(6.0, -10.0) == 10.0
    assert order.done


def test_a_spiral_holds_each_angle_for_the_same_time() -> None:
    order = SpiralOrder((20.0, 0.0, -20.0), 4.0)
    assert [order.steering(at_s, 0.0) for at_s in (0.0, 3.9, 4.0, 7.9, 8.0, 11.9)] == [
        20.0,
        20.0,
        0.0,
        0.0,
        -20.0,
        -20.0,
    ]
    assert not order.done
    assert order.steering(12.0, 0.0) == -20.0
    assert order.done
