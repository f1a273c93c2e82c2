"""Faults of the sensors against closed forms: the same run with and without them, sample by sample."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.reader import read_group
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.run.sensors.sensing import SensorSuite
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds

PHYSICS_HZ = 400
STILL_AIR = np.zeros((1, 3))
IDS = {54002: "imu", 54003: "gnss", 54004: "magnetometer", 54005: "barometer"}


def fault_from(keys: object) -> FaultSpec:
    """A fault as a profile gives it."""
    entry = parse_yaml(json.dumps(keys), "test")
    assert entry is not None
    return read_group(entry, FaultSpec, "test")


def motion(step: int) -> Kinematics:
    """Turning on a circle, so that every axis of every sensor has something to show."""
    t = step / PHYSICS_HZ
    quat = euler_to_quat(np.array([[0.05 * math.sin(t), 0.03 * math.cos(t), 0.1 * t]]))
    rotation = quat_to_matrix(quat)
    zero = np.zeros((1, 3))
    return Kinematics(
        pos_ned_m=np.array([[30 * math.sin(0.1 * t), 30 * math.cos(0.1 * t), 0.02]]),
        vel_ned_mps=np.array([[3 * math.cos(0.1 * t), -3 * math.sin(0.1 * t), 0.0]]),
        acc_ned_mps2=zero,
        quat_ned_frd=quat,
        rot_ned_frd=rotation,
        gyro_frd_radps=np.array([[0.01, -0.02, 0.1]]),
        angular_acc_frd_radps2=zero,
    )


def sensed(
    faults: dict[str, Any] | None, seconds: float, seed: int = 3
) -> tuple[dict[str, dict[int, Any]], SensorSuite]:
    """Messages by sensor and stamp in µs."""
    profile = load_profile("sitl")
    assert profile.sensors is not None
    assert profile.site is not None
    made = None if faults is None else {name: fault_from(fault) for name, fault in faults.items()}
    sensing = SensorSuite(profile.sensors, profile.site, PHYSICS_HZ, Seeds(seed), made)
    by_sensor: dict[str, dict[int, Any]] = {name: {} for name in IDS.values()}
    for step in range(1, round(seconds * PHYSICS_HZ) + 1):
        for message in sensing.due(step, step * 1_000_000_000 // PHYSICS_HZ, motion(step), STILL_AIR):
            of_sensor = by_sensor[IDS[message.get_msgId()]]
            assert message.time_usec not in of_sensor
            of_sensor[message.time_usec] = message
    return by_sensor, sensing


def values(message: Any) -> dict[str, Any]:
    return {name: getattr(message, name) for name in message.fieldnames if name != "time_usec"}


def same(one: Any, other: Any) -> bool:
    return values(one) == values(other)


@pytest.mark.medium
def test_without_faults_nothing_changes() -> None:
    plain, _ = sensed(None, 2.0)
    with_none, sensing = sensed({}, 2.0)
    assert sensing.fault_counts() == {}
    for sensor, messages in plain.items():
        assert messages.keys() == with_none[sensor].keys()
        assert all(same(message, with_none[sensor][stamp]) for stamp, message in messages.items())


@pytest.mark.medium
@pytest.mark.parametrize(
    ("sensor", "fault", "field", "added"),
    [
        ("imu", {"gyro_bias_frd_radps": (0.1, -0.2, 0.3)}, "gyro", (0.1, -0.2, 0.3)),
        ("imu", {"accel_bias_frd_mps2": (0.5, 0.25, -1.0)}, "accel", (0.5, 0.25, -1.0)),
        ("gnss", {"velocity_bias_ned_mps": (1.0, -2.0, 0.5)}, "velocity", (1.0, -2.0, 0.5)),
        ("magnetometer", {"field_bias_frd_gauss": (0.01, 0.02, -0.04)}, "field", (0.01, 0.02, -0.04)),
        ("barometer", {"pressure_bias_pa": -120.0}, "pressure", -120.0),
    ],
)
def test_a_bias_adds_exactly_while_it_lasts_and_touches_nothing_else(
    sensor: str, fault: dict[str, Any], field: str, added: Any
) -> None:
    plain, _ = sensed(None, 3.0)
    faulty, sensing = sensed({"off": {"from_s": 1.0, "until_s": 2.0, sensor: fault}}, 3.0)
    touched = 0
    for name, messages in plain.items():
        assert messages.keys() == faulty[name].keys()
        for stamp, message in messages.items():
            expected = values(message)
            if name == sensor and 1_000_000 <= stamp < 2_000_000:
                touched += 1
                # Doubles until they are packed: one rounding of the sum, relative to values below 2^17.
                expected[field] = pytest.approx(np.add(expected[field], added), abs=1e-10)
            assert values(faulty[name][stamp]) == expected
    assert touched > 0
    assert sensing.fault_counts() == {"off": {f"{sensor}_biased": touched}}


@pytest.mark.medium
def test_a_bias_in_position_moves_the_fix_by_so_many_metres() -> None:
    bias = (3.0, -4.0, 1.5)
    plain, _ = sensed(None, 3.0)
    faulty, _ = sensed({"off": {"gnss": {"position_bias_ned_m": bias}}}, 3.0)
    site = load_profile("sitl").site
    assert site is not None
    frame = local_frame(site)

    def place(message: Any) -> np.ndarray:
        degrees = (np.array([message.lat * 1e-7]), np.array([message.lon * 1e-7]))
        return frame.ned(*degrees, np.array([message.alt * 1e-3]))[0]

    for stamp, message in plain["gnss"].items():
        moved = faulty["gnss"][stamp]
        # Both fixes are rounded to 1e-7 degrees (1.1 cm, so half of it each) and 1 mm.
        assert place(moved) - place(message) == pytest.approx(bias, abs=0.0112)
        assert (moved.h_acc, moved.fix_type, moved.satellites) == (message.h_acc, message.fix_type, message.satellites)


@pytest.mark.medium
def test_a_drift_of_the_position_grows_from_zero_and_leaves_the_velocity() -> None:
    clean, _ = sensed(None, 3.0)
    drifting, _ = sensed({"x": {"from_s": 1.0, "gnss": {"drift_mps": 0.5, "drift_bearing_deg": 90.0}}}, 3.0)
    profile = load_profile("sitl")
    assert profile.site is not None
    frame = local_frame(profile.site)
    for stamp_us, fix in clean["gnss"].items():
        other = drifting["gnss"][stamp_us]
        one, two = (frame.ned(*(np.array([v]) for v in (m.lat / 1e7, m.lon / 1e7, 0.0)))[0] for m in (fix, other))
        assert two[:2] - one[:2] == pytest.approx([0.0, 0.5 * max(stamp_us * 1e-6 - 1.0, 0.0)], abs=0.02)
        assert list(other.velocity) == list(fix.velocity)


@pytest.mark.medium
@pytest.mark.parametrize("sensor", IDS.values())
def test_a_frozen_sensor_repeats_its_last_values_with_new_stamps(sensor: str) -> None:
    plain, _ = sensed(None, 3.0)
    faulty, sensing = sensed({"still": {"from_s": 1.0, "until_s": 2.0, sensor: {"freeze": True}}}, 3.0)
    assert plain[sensor].keys() == faulty[sensor].keys()
    last_before = max(stamp for stamp in plain[sensor] if stamp < 1_000_000)
    frozen = [stamp for stamp in plain[sensor] if 1_000_000 <= stamp < 2_000_000]
    assert all(same(faulty[sensor][stamp], plain[sensor][last_before]) for stamp in frozen)
    after = [stamp for stamp in plain[sensor] if stamp >= 2_000_000]
    assert after
    assert all(same(faulty[sensor][stamp], plain[sensor][stamp]) for stamp in after)
    assert sensing.fault_counts() == {"still": {f"{sensor}_frozen": len(frozen)}}


@pytest.mark.medium
def test_a_sensor_frozen_from_the_start_repeats_its_first_sample() -> None:
    plain, _ = sensed(None, 1.0)
    faulty, _ = sensed({"still": {"barometer": {"freeze": True}}}, 1.0)
    first = plain["barometer"][min(plain["barometer"])]
    assert all(same(message, first) for message in faulty["barometer"].values())


@pytest.mark.medium
def test_a_dropout_takes_its_share_at_random_and_repeats_with_the_seed() -> None:
    share, seconds = 0.3, 5.0
    plain, _ = sensed(None, seconds)
    faults = {"gaps": {"imu": {"dropout": share}}}
    faulty, sensing = sensed(faults, seconds)
    total = len(plain["imu"])
    dropped = total - len(faulty["imu"])
    # Binomial: six standard deviations, exceeded once in 5e8 seeds.
    assert abs(dropped - share * total) < 6 * math.sqrt(total * share * (1 - share))
    assert sensing.fault_counts() == {"gaps": {"imu_dropped": dropped}}
    assert all(same(message, plain["imu"][stamp]) for stamp, message in faulty["imu"].items())
    for sensor in ("gnss", "magnetometer", "barometer"):
        assert plain[sensor].keys() == faulty[sensor].keys()
    again, _ = sensed(faults, seconds)
    assert again["imu"].keys() == faulty["imu"].keys()
    # Neighbours are independent: share^2 of the pairs are lost, with a variance of n p^2 (1 + 2p - 3p^2) < 1.4 n p^2.
    lost = [stamp not in faulty["imu"] for stamp in sorted(plain["imu"])]
    pairs = sum(one and other for one, other in itertools.pairwise(lost))
    assert abs(pairs - share**2 * total) < 6 * math.sqrt(1.4 * total * share**2)
    other_name, _ = sensed({"holes": faults["gaps"]}, seconds)
    assert other_name["imu"].keys() != faulty["imu"].keys()


@pytest.mark.medium
def test_a_dropout_of_one_leaves_nothing_and_ends_on_time() -> None:
    plain, _ = sensed(None, 3.0)
    faulty, _ = sensed({"gone": {"from_s": 1.0, "until_s": 2.0, "gnss": {"dropout": 1.0}}}, 3.0)
    assert faulty["gnss"].keys() == {stamp for stamp in plain["gnss"] if not 1_000_000 <= stamp < 2_000_000}


@pytest.mark.medium
def test_faults_at_the_same_time_add_up() -> None:
    plain, _ = sensed(None, 1.0)
    faults = {
        "one": {"barometer": {"pressure_bias_pa": 100.0}},
        "other": {"from_s": 0.5, "barometer": {"pressure_bias_pa": 20.0}},
    }
    faulty, _ = sensed(faults, 1.0)
    for stamp, message in plain["barometer"].items():
        added = 120.0 if stamp >= 500_000 else 100.0
        assert faulty["barometer"][stamp].pressure == pytest.approx(message.pressure + added, abs=1e-9)
