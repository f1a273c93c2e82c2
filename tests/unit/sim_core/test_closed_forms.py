"""Small models of the vessel, the air and the sensors, each with all figures worked out by hand or by their formula."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from motion import at_rest
from scipy.spatial.transform import Rotation
from vessels import FULL

from sim_core.environment.current import make_current
from sim_core.environment.spec import CurrentSpec, DiscreteGust, WindSpec
from sim_core.environment.wind import (
    StillAir,
    WindState,
    davenport_density,
    discrete_gust_mps,
    discrete_gusts_mps,
    harris_density,
    make_wind,
    npd_density,
    speed_share,
)
from sim_core.geodesy import LocalFrame
from sim_core.geojson import GeoJsonError, read_geometries
from sim_core.keys import SpecificationError
from sim_core.mesh_file import MeshFileError, modified_ns, read_triangles
from sim_core.sensors.barometer import Barometer, pressure_pa
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.magnetometer import Magnetometer
from sim_core.sensors.measurement import centripetal_matrix, cross_matrix, digitiser, joined_digitiser, pair_products
from sim_core.sensors.rangefinder import Rangefinder
from sim_core.sensors.spec import BarometerSpec, GnssSpec, MagnetometerSpec, RangefinderSpec
from sim_core.vessel.battery import Battery, BatteryCondition, BatteryState
from sim_core.vessel.condition import (
    ActuatorFault,
    BatteryDamage,
    Condition,
    healthy,
    make_condition,
    with_row,
)
from sim_core.vessel.derivatives import parse_derivative
from sim_core.vessel.spec import BatterySpec, Windage
from sim_core.vessel.windage import WindDrag

SPEC = BatterySpec(
    cells=4,
    full_voltage_v=16.0,
    empty_voltage_v=12.0,
    capacity_ah=10.0,
    resistance_ohm=0.1,
    full_current_a=20.0,
    idle_current_a=2.0,
    initial_charge=0.75,
)
UNEVEN = replace(
    FULL,
    battery=SPEC,
    propellers=(replace(FULL.propellers[0], max_thrust_n=300.0), replace(FULL.propellers[1], max_thrust_n=100.0)),
)


def battery() -> Battery:
    made = Battery.from_spec(UNEVEN, 0.5)
    assert made is not None
    return made


def test_a_battery_begins_at_its_charge_with_the_current_of_the_other_loads() -> None:
    """0.75 of the charge: 12 V + 0.75 * 4 V - 0.1 ohm * 2 A."""
    assert Battery.from_spec(FULL, 0.5) is None
    state = battery().initial(3)
    assert state.used_as.tolist() == [9000.0] * 3
    assert state.current_a.tolist() == [2.0] * 3
    assert state.voltage_v == pytest.approx([14.8] * 3)


def test_each_propeller_draws_its_share_of_the_current_by_the_cube_of_its_speed() -> None:
    """The first one has three quarters of the thrust. Two vessels, one of them astern."""
    speed = np.array([[1.0, 0.5], [-0.5, 0.0]])
    state, left = battery().step(battery().initial(2), speed, None)
    current_a = [2.0 + 20.0 * (0.75 + 0.25 * 0.125), 2.0 + 20.0 * 0.75 * 0.125]
    used_as = [9000.0 + 0.5 * current for current in current_a]
    assert state.current_a == pytest.approx(current_a)
    assert state.used_as == pytest.approx(used_as)
    volts = [16.0 - 4.0 * used / 36000.0 - 0.1 * current for used, current in zip(used_as, current_a, strict=True)]
    assert state.voltage_v == pytest.approx(volts)
    assert left.tolist() == [[1.0], [1.0]]


def test_faults_of_a_battery_leave_a_share_of_the_speed() -> None:
    """A cell of four, 1 V, and 0.2 ohm: open circuit 15 V * 3/4 - 1 V - 0.3 ohm * 22 A of 15 V - 0.1 ohm * 22 A."""
    condition = BatteryCondition(np.array([0.2, 0.0, 9.0]), np.array([0.75, 1.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    before = BatteryState(np.full(3, 9000.0 - 11.0), np.zeros(3), np.zeros(3))
    state, left = battery().step(before, np.ones((3, 2)), condition)
    assert state.voltage_v == pytest.approx([15.0 * 0.75 - 1.0 - 0.3 * 22.0, 12.8, 0.0])
    assert left[:, 0] == pytest.approx([3.65 / 12.8, 1.0, 0.0])


def test_an_empty_battery_has_its_empty_voltage() -> None:
    state, _ = battery().step(BatteryState(np.array([1e6]), np.zeros(1), np.zeros(1)), np.zeros((1, 2)), None)
    assert state.voltage_v == pytest.approx([12.0 - 0.1 * 2.0])


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"empty_voltage_v": 16.0}, None),
        ({"empty_voltage_v": 16.1}, r"= 16.1 is above full_voltage_v \(16\)"),
        ({"resistance_ohm": 0.27}, None),
        ({"resistance_ohm": 6.0 / 22.0}, "takes half of empty_voltage_v or more at full_current_a"),
    ],
)
def test_a_battery_has_a_voltage_left_at_full_current(keys: dict[str, float], text: str | None) -> None:
    if text is None:
        replace(SPEC, **keys)
        return
    with pytest.raises(SpecificationError, match=text):
        replace(SPEC, **keys)


def test_faults_of_a_vessel_combine() -> None:
    """Losses multiply, the last holding counts, two reversals cancel, and no more cells fail than there are."""
    faults = [
        ActuatorFault("propeller 0", thrust_loss=0.5),
        ActuatorFault("propeller 0", thrust_loss=0.2, reversed=True),
        ActuatorFault("propeller 1", held_at=0.3),
        ActuatorFault("propeller 1", held_at=-0.4, reversed=True),
        ActuatorFault("propeller 1", reversed=True),
    ]
    damage = [BatteryDamage(0.1, 3, 0.5), BatteryDamage(0.2, 2, 0.25)]
    condition = make_condition(UNEVEN, faults, damage)
    assert condition is not None
    assert condition.thrust_share == pytest.approx(np.array([[0.4, 1.0]]))
    assert condition.sign.tolist() == [[-1.0, 1.0]]
    assert condition.actual(np.array([[0.7, 0.6], [0.1, 0.2]])).tolist() == [[-0.7, -0.4], [-0.1, -0.4]]
    assert condition.battery.added_resistance_ohm == pytest.approx([0.3])
    assert condition.battery.cell_share.tolist() == [0.0]
    assert condition.battery.voltage_drop_v.tolist() == [0.75]
    assert make_condition(UNEVEN, [], []) is None
    one_cell = make_condition(FULL, [], [BatteryDamage(failed_cells=1)])
    assert one_cell is not None
    assert one_cell.battery.cell_share.tolist() == [0.0]
    quarter = make_condition(UNEVEN, [], [BatteryDamage(failed_cells=1)])
    assert quarter is not None
    assert quarter.battery.cell_share.tolist() == [0.75]


def test_a_faulty_vessel_has_its_row_among_healthy_ones() -> None:
    own = make_condition(UNEVEN, [ActuatorFault("propeller 1", 0.5, 0.2, True)], [BatteryDamage(0.1, 1, 0.5)])
    assert own is not None
    among = with_row(healthy(UNEVEN, 3), 1, own)
    for part in fields(Condition):
        if part.name == "battery":
            continue
        mine, all_of = getattr(own, part.name), getattr(among, part.name)
        np.testing.assert_array_equal(all_of[1], mine[0])
        np.testing.assert_array_equal(all_of[[0, 2]], getattr(healthy(UNEVEN, 2), part.name))
    assert among.battery.added_resistance_ohm.tolist() == [0.0, 0.1, 0.0]
    assert among.battery.cell_share.tolist() == [1.0, 0.75, 1.0]
    assert among.battery.voltage_drop_v.tolist() == [0.0, 0.5, 0.0]


@pytest.mark.parametrize(
    ("name", "component", "acceleration", "factors", "linear", "own_order"),
    [
        ("X_udot", 0, 0, (), None, 0),
        ("N_rdot", 5, 5, (), None, 0),
        ("Y_v", 1, None, ((1, False),), 1, 1),
        ("N_r", 5, None, ((5, False),), 5, 1),
        ("Y_r", 1, None, ((5, False),), 5, 0),
        ("X_uu", 0, None, ((0, True), (0, False)), None, 2),
        ("X_vr", 0, None, ((1, False), (5, False)), None, 0),
        ("X_vv", 0, None, ((1, False), (1, False)), None, 0),
        ("Y_uv", 1, None, ((0, False), (1, False)), None, 0),
        ("Y_vv", 1, None, ((1, True), (1, False)), None, 2),
        ("Y_rv", 1, None, ((5, True), (1, False)), None, 0),
        ("K_pp", 3, None, ((3, True), (3, False)), None, 2),
        ("N_vr", 5, None, ((1, True), (5, False)), None, 0),
        ("Z_ww", 2, None, ((2, True), (2, False)), None, 2),
        ("Z_wq", 2, None, ((2, True), (4, False)), None, 0),
        ("Z_uw", 2, None, ((0, False), (2, False)), None, 0),
        ("M_qq", 4, None, ((4, True), (4, False)), None, 2),
        ("Y_|r|v", 1, None, ((5, True), (1, False)), None, 0),
        ("Y_v|v|", 1, None, ((1, False), (1, True)), None, 2),
        ("Y_|v|", 1, None, ((1, True),), None, 0),
        ("X_uuu", 0, None, ((0, False),) * 3, None, 3),
        ("X_|u|uu", 0, None, ((0, True), (0, False), (0, False)), None, 0),
    ],
)
def test_derivatives_are_products_by_their_names(
    name: str, component: int, acceleration: int | None, factors: tuple, linear: int | None, own_order: int
) -> None:
    found = parse_derivative(name)
    assert (found.component, found.acceleration, found.factors) == (component, acceleration, factors)
    assert (found.linear, found.own_order) == (linear, own_order)


def test_two_names_of_one_derivative_have_one_term() -> None:
    assert parse_derivative("X_vr").term == parse_derivative("X_rv").term
    assert parse_derivative("Y_rv").term != parse_derivative("Y_vr").term
    for name in ("Y_", "Y_vvvv", "A_v", "Y_x", "Y_vdotv", "Y|v|v", "Y_|v"):
        with pytest.raises(ValueError, match="is not a derivative"):
            parse_derivative(name)


@pytest.mark.parametrize("air", [(3.0, 4.0), (-3.0, 4.0), (3.0, -4.0), (0.0, -2.0), (0.0, 0.0)])
def test_the_force_of_the_air_is_fossens_about_the_height_of_its_areas(air: tuple[float, float]) -> None:
    """Equations 10.16 to 10.18, with the areas 0.7 m above a waterline that is 0.2 m below the origin."""
    wind = Windage(0.9, 1.3, 2.3, 0.7, 0.8, 0.1, height_m=0.7)
    drag = WindDrag.from_spec(replace(FULL, wind=wind), 0.2)
    u, v = air
    speed = math.hypot(u, v)
    x = -0.5 * 1.2 * wind.surge_coefficient * wind.frontal_area_m2 * u * speed
    y = -0.5 * 1.2 * wind.sway_coefficient * wind.lateral_area_m2 * v * speed
    n = -1.2 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m * u * v
    z_m = 0.2 - 0.7
    terms = np.concatenate(drag.terms(np.array([[u, v, 9.0]])), axis=1)
    assert (terms @ drag.wrench)[0] == pytest.approx([x, y, 0.0, -z_m * y, z_m * x, n])


# -- air and water

GUST = DiscreteGust(start_s=10.0, rise_s=4.0, hold_s=3.0, fall_s=2.0, speed_mps=8.0)


@pytest.mark.parametrize(
    ("time_s", "speed_mps"),
    [
        (0.0, 0.0),
        (10.0, 0.0),
        (11.0, 4.0 * (1.0 - math.sqrt(0.5))),
        (12.0, 4.0),
        (14.0, 8.0),
        (17.0, 8.0),
        (18.0, 4.0),
        (18.5, 4.0 * (1.0 - math.sqrt(0.5))),
        (19.0, 0.0),
        (99.0, 0.0),
    ],
)
def test_a_gust_rises_holds_and_falls(time_s: float, speed_mps: float) -> None:
    assert discrete_gust_mps(GUST, time_s) == pytest.approx(speed_mps, abs=1e-12)
    late = replace(GUST, start_s=20.0, speed_mps=-3.0)
    both = discrete_gusts_mps((GUST, late), np.array([time_s, time_s + 10.0]))
    assert both[0] == pytest.approx(speed_mps + discrete_gust_mps(late, time_s), abs=1e-12)
    assert both[1] == pytest.approx(discrete_gust_mps(GUST, time_s + 10.0) - 3.0 / 8.0 * speed_mps, abs=1e-12)


def test_the_wind_blows_from_its_direction_with_its_gusts_and_veers() -> None:
    spec = WindSpec(mean_mps=5.0, direction_deg=30.0, discrete_gusts=(GUST,), profile="power", exponent=0.2)
    air = make_wind(spec)
    veer_rad = np.array([0.0, 0.4])
    for began_s, speeds in ((None, [13.0, 13.0]), (np.array([0.0, -3.0]), [13.0, 9.0])):
        state = WindState(np.zeros(2), veer_rad, began_s=began_s)
        course = math.radians(210.0) + veer_rad
        expected = np.stack([speeds * np.cos(course), speeds * np.sin(course), np.zeros(2)], axis=1)
        np.testing.assert_allclose(air.velocity_ned_mps(state, 15.0), expected, atol=1e-12)
        higher = expected * (3.0 / spec.reference_height_m) ** 0.2
        np.testing.assert_allclose(air.velocity_ned_mps(state, 15.0, 3.0), higher, atol=1e-12)
    falling = make_wind(replace(spec, discrete_gusts=(replace(GUST, speed_mps=-9.0),)))
    assert not falling.velocity_ned_mps(WindState(np.zeros(1), np.zeros(1)), 15.0).any(), "it never reverses"
    calm = make_wind(WindSpec())
    assert isinstance(calm, StillAir)
    assert calm.share(np.array([1.0, 20.0])).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("profile", "height_m", "share"),
    [
        ("uniform", 40.0, 1.0),
        ("power", 10.0, 1.0),
        ("power", 2.5, 0.25**0.2),
        ("power", 0.0, 0.005**0.2),
        ("logarithmic", 10.0, 1.0),
        ("logarithmic", 1.0, math.log(1.0 / 0.001) / math.log(10.0 / 0.001)),
    ],
)
def test_the_speed_grows_with_the_height(profile: str, height_m: float, share: float) -> None:
    """Below 5 cm, it is that of 5 cm."""
    spec = WindSpec(mean_mps=5.0, reference_height_m=10.0, profile=profile, exponent=0.2, roughness_m=0.001)  # type: ignore[arg-type]
    assert float(speed_share(spec, height_m)) == pytest.approx(share)


def test_densities_of_gusts_are_the_published_ones() -> None:
    """NORSOK N-003, Harris 1971 and Davenport 1961, for 12 m/s at 5 m and 0.02 Hz."""
    f, mean_mps, height_m = 0.02, 12.0, 5.0
    x = 172.0 * f * 0.5 ** (2.0 / 3.0) * 1.2**-0.75
    npd = 320.0 * 1.2**2 * 0.5**0.45 / (1.0 + x**0.468) ** (5.0 / (3.0 * 0.468))
    harris = 4.0 * 0.003 * 1800.0 * 12.0 / (2.0 + 3.0**2) ** (5.0 / 6.0)
    davenport = 4.0 * 0.003 * 12.0**2 * 2.0**2 / (f * (1.0 + 2.0**2) ** (4.0 / 3.0))
    at = np.array([f])
    assert npd_density(at, mean_mps, height_m) == pytest.approx([npd])
    assert harris_density(at, mean_mps, height_m) == pytest.approx([harris])
    assert davenport_density(at, mean_mps, height_m) == pytest.approx([davenport])


def test_a_current_in_a_channel_slackens_with_the_distance_from_its_middle() -> None:
    """To the south-east at 30 degrees east of south, a channel of 20 m about (5, -3), half as fast at its banks."""
    spec = CurrentSpec(
        2.0,
        150.0,
        channel_width_m=20.0,
        channel_bank_ratio=0.5,
        channel_bank_exponent=2.0,
        channel_centre_ned_m=(5.0, -3.0),
    )
    along = np.array([math.cos(math.radians(150.0)), math.sin(math.radians(150.0)), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    places = np.array([5.0, -3.0, 0.0]) + np.outer([0.0, 5.0, -5.0, 10.0, -30.0], across) + 7.0 * along
    velocity = make_current(spec).velocity_ned_mps(np.array([0.0, 0.0, 0.2, 0.0, 0.0]), places)
    speeds = [2.0, 2.0 * 0.875, 2.2 * 0.875, 1.0, 1.0]
    np.testing.assert_allclose(velocity, np.outer(speeds, along), atol=1e-12)


# -- sensors


def test_a_lever_arm_has_its_velocity_and_its_acceleration() -> None:
    rng = np.random.default_rng(1)
    arm = (0.4, -1.2, 2.5)
    rate = rng.normal(size=(4, 3))
    np.testing.assert_allclose(rate @ cross_matrix(arm), np.cross(rate, arm))
    np.testing.assert_allclose(pair_products(rate) @ centripetal_matrix(arm), np.cross(rate, np.cross(rate, arm)))


def test_digitisers_round_to_their_step_and_saturate() -> None:
    values = np.array([[0.24, -0.26, 7.0, -7.0, 0.3]])
    assert digitiser(0.5, 5.0).read(values).tolist() == [[0.0, -0.5, 5.0, -5.0, 0.5]]
    assert digitiser(0.5).read(values).tolist() == [[0.0, -0.5, 7.0, -7.0, 0.5]]
    assert digitiser(0.0, 5.0).read(values).tolist() == [[0.24, -0.26, 5.0, -5.0, 0.3]]
    assert digitiser(0.0).read(values) is values
    joined = joined_digitiser((2, 0.5, None), (2, 0.0, 6.0), (1, 0.2, 0.1))
    assert joined.read(values)[0] == pytest.approx([0.0, -0.5, 6.0, -6.0, 0.1])
    free = joined_digitiser((3, 0.0, None), (2, 0.0, None))
    assert free.resolution is free.full_scale is free.least is None


def test_pressure_and_temperature_are_those_of_the_standard_atmosphere() -> None:
    """ISO 2533: 89 874.6 Pa and 8.5 degrees at 1000 m; 101 325 Pa and 15 degrees at sea level."""
    assert pressure_pa(np.array([0.0, 1000.0, 5000.0])) == pytest.approx([101_325.0, 89_874.6, 54_019.9], rel=2e-6)
    assert pressure_pa(np.array([1000.0]), 100_000.0) == pytest.approx([100_000.0 / 101_325.0 * 89_874.6], rel=2e-6)
    unit = Barometer(
        BarometerSpec(rate_hz=10.0, noise_pa=0.0, drift_pa=0.0, resolution_pa=0.0), origin_altitude_m=900.0
    )
    rng = np.random.default_rng(1)
    _, sample = unit.measure(unit.initial(1, rng), at_rest(pos_ned_m=(0.0, 0.0, -100.0)), rng)
    assert sample.pressure_pa == pytest.approx([89_874.6], rel=2e-6)
    assert sample.temperature_degc == pytest.approx([8.5])


def test_a_receiver_measures_its_antenna_and_tells_the_rms_of_its_errors() -> None:
    spec = GnssSpec(
        rate_hz=5.0,
        horizontal_noise_m=0.3,
        vertical_noise_m=0.6,
        horizontal_drift_m=0.4,
        vertical_drift_m=0.8,
        velocity_noise_mps=0.1,
        satellites=9,
        antenna_frd_m=(1.0, -2.0, -3.0),
    )
    state = Gnss(spec, LocalFrame(10.0, 20.0, 30.0)).initial(2, np.random.default_rng(1))
    assert state.horizontal_accuracy_m == pytest.approx([math.sqrt(2.0) * 0.5] * 2)
    assert state.vertical_accuracy_m == pytest.approx([1.0] * 2)
    assert state.speed_accuracy_mps == pytest.approx([math.sqrt(3.0) * 0.1] * 2)
    assert (state.fix_type.tolist(), state.satellites.tolist()) == ([3, 3], [9, 9])
    still = replace(spec, horizontal_noise_m=0.0, vertical_noise_m=0.0, horizontal_drift_m=0.0, vertical_drift_m=0.0)
    unit = Gnss(replace(still, velocity_noise_mps=0.0), LocalFrame(10.0, 20.0, 30.0))
    turning = replace(
        at_rest(euler_rad=(0.1, 0.2, 1.0), pos_ned_m=(4.0, 5.0, 6.0)),
        gyro_frd_radps=np.array([[0.2, -0.1, 0.5]]),
        vel_ned_mps=np.array([[1.0, 2.0, 3.0]]),
    )
    rng = np.random.default_rng(1)
    _, sample = unit.measure(unit.initial(1, rng), turning, rng)
    turn = Rotation.from_euler("ZYX", [1.0, 0.2, 0.1])
    place = np.array([4.0, 5.0, 6.0]) + turn.apply(spec.antenna_frd_m)
    lat_deg, lon_deg, alt_m = LocalFrame(10.0, 20.0, 30.0).geodetic(place[None])
    assert (sample.lat_deg[0], sample.lon_deg[0]) == pytest.approx((lat_deg[0], lon_deg[0]), abs=1e-12)
    assert sample.alt_m == pytest.approx(alt_m)
    swing = turn.apply(np.cross([0.2, -0.1, 0.5], spec.antenna_frd_m))
    assert sample.vel_ned_mps[0] == pytest.approx(np.array([1.0, 2.0, 3.0]) + swing)


def test_a_magnetometer_measures_the_field_in_its_axes_and_its_iron() -> None:
    spec = MagnetometerSpec(
        rate_hz=50.0,
        noise_density_gaussprthz=0.0,
        bias_instability_gauss=0.0,
        resolution_gauss=0.0,
        hard_iron_frd_gauss=(0.01, -0.02, 0.03),
    )
    unit = Magnetometer(spec, (0.25, -0.06, 0.1))
    rng = np.random.default_rng(1)
    _, sample = unit.measure(unit.initial(1, rng), at_rest(euler_rad=(0.3, -0.2, 0.7)), rng)
    inside = Rotation.from_euler("ZYX", [0.7, -0.2, 0.3]).inv().apply([0.25, -0.06, 0.1])
    assert sample.field_frd_gauss[0] == pytest.approx(np.array([0.01, -0.02, 0.03]) + inside)


@pytest.mark.parametrize(
    ("keys", "tilt_deg", "range_m"),
    [
        ({}, 0.0, 8.0),
        ({}, 60.0, 16.0),
        ({"beam_deg": 20.0}, 60.0, 8.0 / math.cos(math.radians(50.0))),
        ({"beam_deg": 20.0}, 9.0, 8.0),
        ({"direction_frd": (0.0, 0.0, -2.0)}, 0.0, math.inf),
        ({"direction_frd": (3.0, 0.0, 0.0)}, 0.0, math.inf),
        ({"direction_frd": (0.0, 0.0, 5.0), "position_frd_m": (0.0, 0.0, 3.0)}, 0.0, 5.0),
        ({"position_frd_m": (0.0, 0.0, 9.0)}, 0.0, 0.0),
        ({"resolution_m": 0.3}, 0.0, 8.1),
    ],
)
def test_a_rangefinder_measures_along_the_steepest_part_of_its_beam(
    keys: dict[str, object], tilt_deg: float, range_m: float
) -> None:
    """2 m below the surface over a bed of 10 m."""
    unit = Rangefinder(
        RangefinderSpec(beam_deg=0.0, **keys) if "beam_deg" not in keys else RangefinderSpec(**keys), 10.0
    )  # type: ignore[arg-type]
    motion = at_rest(euler_rad=(0.0, math.radians(tilt_deg), 0.0), pos_ned_m=(0.0, 0.0, 2.0))
    _, sample = unit.measure(None, motion, np.random.default_rng(1))
    assert sample.range_m == pytest.approx([range_m])


# -- files


def test_geometries_of_a_document_have_their_place_and_properties() -> None:
    point = {"type": "Point", "coordinates": [1.0, 2.0]}
    nested = {
        "type": "GeometryCollection",
        "geometries": [point, {"type": "GeometryCollection", "geometries": [point]}],
    }
    document = {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "geometry": point, "properties": {"name": "a"}},
            {"type": "Feature", "geometry": None},
            {"type": "Feature", "geometry": nested, "properties": {"name": "b"}},
        ],
        "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
    }
    found = [(one.where, dict(one.members), one.properties) for one in read_geometries(document)]
    assert found == [
        ("features.0.geometry.", point, {"name": "a"}),
        ("features.1.geometry.", {}, None),
        ("features.2.geometry.geometries.0.", point, {"name": "b"}),
        ("features.2.geometry.geometries.1.geometries.0.", point, {"name": "b"}),
    ]
    assert [one.where for one in read_geometries(point)] == [""]
    assert [one.where for one in read_geometries({"type": "Feature", "geometry": point})] == ["geometry."]
    deep = point
    for _ in range(9):
        deep = {"type": "GeometryCollection", "geometries": [deep]}  # type: ignore[dict-item]
    (bottom,) = read_geometries(deep)
    assert bottom.members["type"] == "GeometryCollection", "eight levels are opened"
    assert bottom.where.count("geometries.") == 8


@pytest.mark.parametrize(
    ("document", "text"),
    [
        ([], "is not GeoJSON; a file is a FeatureCollection"),
        ({"type": "Point", "crs": {"properties": {"name": "EPSG:3857"}}}, "crs is not WGS84"),
        ({"type": "FeatureCollection", "features": {}}, "features is not a list"),
        ({"type": "FeatureCollection", "features": [1]}, "features.0 is not an object"),
        ({"type": "GeometryCollection"}, "geometries is not a list"),
    ],
)
def test_what_is_no_geojson_is_refused(document: object, text: str) -> None:
    with pytest.raises(GeoJsonError, match=text):
        list(read_geometries(document))


@pytest.mark.medium
def test_meshes_are_read_from_files_that_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "part.obj"
    assert modified_ns(str(path)) == 0
    with pytest.raises(MeshFileError, match="does not exist"):
        read_triangles(path)
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 2 3\nf 1 3 4\n")
    assert modified_ns(str(path)) == path.stat().st_mtime_ns
    vertices, faces = read_triangles(path)
    corners = vertices[faces]
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert sorted((0.5 * twice).tolist()) == [1.0, 3.0]
    with pytest.raises(MeshFileError, match="is not of a known format; use one of"):
        read_triangles(tmp_path / "part.doc")
    monkeypatch.setattr("sim_core.mesh_file.LARGEST_BYTES", path.stat().st_size - 1)
    with pytest.raises(MeshFileError, match="MiB; reduce the mesh"):
        read_triangles(path)
    damaged = tmp_path / "damaged.glb"
    damaged.write_bytes(b"glTF but no more")
    with pytest.raises(MeshFileError, match="cannot be read as glb"):
        read_triangles(damaged)
