"""Satellite receivers of every kind of log: units, unknown values and the frame of the velocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.table import Column
from xitl_cli.logs.signals.receivers import GnssReceiver, gnss_receivers, injected_receivers

SECOND = 1_000_000_000
NAN = np.nan


def one(*tables: MadeTable, kind: Any = "dataflash") -> GnssReceiver:
    (receiver,) = gnss_receivers(MadeLog(*tables, kind=kind))
    return receiver


def table(name: str, rows: int = 3, instance: str | None = None, **columns: Any) -> MadeTable:
    every = {key: np.broadcast_to(value, rows) if np.ndim(value) < 2 else value for key, value in columns.items()}
    return MadeTable(name, SECOND * np.arange(rows), every, instance=instance)


def test_a_receiver_of_ardupilot() -> None:
    gps = table(
        "GPS", 5, I=0, Status=[1, 3, 3, 6, 3], NSats=[0, 9, 255, 12, 10], HDop=[99.9, 0.8, 0.7, 0.6, 0.7],
        Lat=[0.0, 47.0, 91.0, 47.1, 47.2], Lng=[0.0, 8.0, 8.0, -181.0, 8.2], Spd=2.0,
        GCrs=[0.0, 90.0, 180.0, 270.0, 30.0],
        VZ=[0.1, 0.2, 0.3, 0.4, 0.5], GWk=2300, GMS=[1, 2, 3, 4, 5], instance="I",
    )  # fmt: skip
    gpa = table("GPA", 5, I=0, HAcc=[9.0, 1.0, 1.1, 1.2, 1.3], VAcc=0.0, SAcc=0.2, SMS=[1, 2, 3, 4, 5], Delta=200,
                instance="I")  # fmt: skip
    receiver = one(gps, gpa)
    assert (receiver.name, receiver.message) == ("GPS[0]", "GPS")
    assert receiver.fields == {
        "lat": "Lat", "lon": "Lng", "fix": "Status", "satellites": "NSats", "hdop": "HDop", "speed": "Spd",
        "course": "GCrs", "down": "VZ",
    }  # fmt: skip
    assert receiver.fix.tolist() == [1, 3, 3, 6, 3]
    np.testing.assert_array_equal(receiver.satellites, [0, 9, NAN, 12, 10])
    np.testing.assert_array_equal(receiver.hdop, [99.9, 0.8, 0.7, 0.6, 0.7])
    np.testing.assert_array_equal(receiver.lat_deg, [NAN, 47.0, NAN, NAN, 47.2])  # no fix, and impossible places
    np.testing.assert_array_equal(receiver.lon_deg, [NAN, 8.0, NAN, NAN, 8.2])
    expected = [[2, 0, 0.1], [0, 2, 0.2], [-2, 0, 0.3], [0, -2, 0.4], [3**0.5, 1, 0.5]]
    np.testing.assert_allclose(receiver.vel_ned_mps, expected, atol=1e-12)
    np.testing.assert_array_equal(receiver.speed_mps, [2.0] * 5)
    np.testing.assert_array_equal(receiver.week, [2300] * 5)
    accuracy = receiver.accuracy
    assert accuracy is not None
    assert accuracy.message == "GPA"
    np.testing.assert_array_equal(accuracy.horizontal_m, [9.0, 1.0, 1.1, 1.2, 1.3])
    assert accuracy.vertical_m is None  # 0 throughout is not reported
    np.testing.assert_array_equal(accuracy.speed_mps, [0.2] * 5)
    np.testing.assert_array_equal(accuracy.message_ms, [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(accuracy.interval_ms, [200] * 5)


def test_the_accuracy_of_a_receiver_is_that_of_its_instance() -> None:
    numbers = [0, 1] * 3
    gps = table("GPS", 6, I=numbers, Status=3, Lat=47.0, Lng=8.0, instance="I")
    gpa = table("GPA", 6, I=[1] * 6, HAcc=2.0, VAcc=1.0, SAcc=1.0, SMS=1, Delta=1, instance="I")
    first, second = gnss_receivers(MadeLog(gps, gpa))
    assert (first.name, first.accuracy) == ("GPS[0]", None)
    assert second.accuracy is not None
    assert len(second.accuracy.stamp_ns) == 6


def test_without_course_or_speed_only_the_vertical_velocity_is_known() -> None:
    np.testing.assert_array_equal(
        one(table("GPS", Status=3, Lat=47.0, Lng=8.0, Spd=1.0, VZ=0.5)).vel_ned_mps, [[NAN, NAN, 0.5]] * 3
    )
    np.testing.assert_array_equal(one(table("GPS", Status=3, Lat=47.0, Lng=8.0)).vel_ned_mps, [[NAN] * 3] * 3)
    level = one(table("GPS", Status=3, Lat=47.0, Lng=8.0, Spd=1.0, GCrs=0.0))
    np.testing.assert_array_equal(level.vel_ned_mps, [[1.0, 0.0, NAN]] * 3)


def test_mavlink_has_a_number_for_unknown() -> None:
    raw = table(
        "GPS_RAW_INT", fix_type=3, satellites_visible=8, eph=[120, 65535, 90], vel=[100, 65535, 300], cog=90.0,
        lat=47.0, lon=8.0, h_acc=[1.5, 2.0, 2.5], v_acc=3.0, vel_acc=0.4,
    )  # fmt: skip
    receiver = one(raw, kind="tlog")
    np.testing.assert_allclose(receiver.hdop, [1.2, NAN, 0.9])
    np.testing.assert_array_equal(receiver.speed_mps, [100, NAN, 300])
    assert receiver.accuracy is not None
    np.testing.assert_array_equal(receiver.accuracy.horizontal_m, [1.5, 2.0, 2.5])
    np.testing.assert_array_equal(receiver.accuracy.vertical_m, [3.0] * 3)
    np.testing.assert_array_equal(receiver.accuracy.speed_mps, [0.4] * 3)
    assert receiver.accuracy.message_ms is None


def test_a_receiver_of_px4_states_metres() -> None:
    gps = table(
        "sensor_gps", fix_type=3, satellites_used=8, eph=[1.1, 1.2, 1.3], epv=2.0, s_variance_m_s=0.3, hdop=0.9,
        latitude_deg=47.0, longitude_deg=8.0, vel_m_s=5.0, vel_n_m_s=3.0, vel_e_m_s=4.0, vel_d_m_s=-0.5,
    )  # fmt: skip
    receiver = one(gps, kind="ulog")
    np.testing.assert_array_equal(receiver.vel_ned_mps, [[3.0, 4.0, -0.5]] * 3)
    np.testing.assert_array_equal(receiver.hdop, [0.9] * 3)
    assert receiver.accuracy is not None
    np.testing.assert_array_equal(receiver.accuracy.horizontal_m, [1.1, 1.2, 1.3])
    np.testing.assert_array_equal(receiver.accuracy.vertical_m, [2.0] * 3)
    np.testing.assert_array_equal(receiver.accuracy.speed_mps, [0.3] * 3)


def test_the_combination_of_px4_counts_only_without_its_receivers() -> None:
    old = table("vehicle_gps_position", fix_type=3, lat=47.0, lon=8.0)
    assert one(old, kind="ulog").message == "vehicle_gps_position"
    new = table("sensor_gps", fix_type=3, latitude_deg=47.0, longitude_deg=8.0)
    assert one(old, new, kind="ulog").message == "sensor_gps"


def test_a_receiver_of_ros() -> None:
    covariance = np.zeros((4, 9))
    covariance[:, [0, 4, 8]] = [[1.0, 7.0, 9.0], [-1.0, 8.0, 4.0], [0.0, 2.0, 1.0], [2.0, 0.0, 0.0]]
    fix = table(
        "/gps/fix", 4, **{"status.status": [-1, 0, 1, 2], "latitude": [47.0] * 4, "longitude": [8.0] * 4},
        position_covariance=covariance,
    )  # fmt: skip
    receiver = one(fix, kind="mcap")
    assert receiver.fix.tolist() == [1, 3, 4, 4]
    np.testing.assert_array_equal(receiver.lat_deg, [NAN, 47.0, 47.0, 47.0])
    assert receiver.accuracy is not None
    np.testing.assert_array_equal(receiver.accuracy.horizontal_m, [2.0, 2.0, 1.0, 1.0])
    np.testing.assert_array_equal(receiver.accuracy.vertical_m, [3.0, 2.0, 1.0, 0.0])


def injected(rows: int = 3) -> MadeTable:
    return table(
        "/link/agent/tx:XITL_GNSS", rows, fix_type=3, satellites=9, lat=47.0, lon=8.0,
        velocity=np.tile([3.0, 4.0, 0.5], (rows, 1)),
    )  # fmt: skip


def test_fixes_that_a_run_sent_to_its_autopilot() -> None:
    link = MadeTable("/link/agent/tx", [0], {"frame": [0]})
    (receiver,) = injected_receivers(MadeLog(link, injected(), kind="mcap"))
    assert receiver.name == "XITL_GNSS"
    np.testing.assert_array_equal(receiver.vel_ned_mps, [[3.0, 4.0, 0.5]] * 3)
    np.testing.assert_array_equal(receiver.speed_mps, [5.0] * 3)
    assert injected_receivers(MadeLog(link, injected(2), kind="mcap")) == []
    assert injected_receivers(MadeLog(injected(), kind="mcap")) == []


@pytest.mark.parametrize(
    ("columns", "many"),
    [
        ({"Status": 2, "Lat": 47.0, "Lng": 8.0}, 1),
        ({"Status": 1, "Lat": 47.0, "Lng": 8.0}, 0),
        ({"Status": 1, "Lat": 47.0, "Lng": 8.0, "NSats": 0}, 0),
        ({"Status": 1, "Lat": 47.0, "Lng": 8.0, "NSats": [0, 0, 1]}, 1),
        ({"Status": 3, "Lat": 47.0}, 0),
        ({"Lat": 47.0, "Lng": 8.0}, 0),
    ],
)
def test_a_receiver_has_a_fix_or_a_satellite(columns: dict[str, Any], many: int) -> None:
    assert len(gnss_receivers(MadeLog(table("GPS", **columns)))) == many
    assert gnss_receivers(MadeLog(table("GPS", 2, Status=3, Lat=47.0, Lng=8.0))) == []


def test_a_column_of_texts_is_no_place() -> None:
    columns = {name: Column(name, kind="text") for name in ("Lat", "Lng")} | {"Status": Column("Status")}
    made = MadeTable("GPS", [1, 2, 3], {"Status": [3] * 3, "Lat": ["x"] * 3, "Lng": ["x"] * 3}, columns=columns)
    assert gnss_receivers(MadeLog(made)) == []


def test_the_place_0_0_is_none() -> None:
    receiver = one(table("GPS", Status=3, Lat=[0.0, 0.0, 1.0], Lng=[0.0, 1.0, 0.0]))
    np.testing.assert_array_equal(receiver.lat_deg, [NAN, 0.0, 1.0])
    np.testing.assert_array_equal(receiver.lon_deg, [NAN, 1.0, 0.0])
