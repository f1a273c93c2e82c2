"""No sensors for a set time: neutral, said once, resumed when they are back; at a node that sails a mission."""

from __future__ import annotations

from typing import Any

import pytest
from boat import DECLINATION_RAD, LAT_DEG, LON_DEG, STEP_NS, Boat, Noise, Sensors, degrees
from node_host import LOCKSTEP, MS, REALTIME, START, Host, of, texts

from agent.fcu.mission import make_mission, waypoint
from agent.fcu.vehicle import modes
from agent.navigation.measurements import BarometerMeasurement, GnssMeasurement, ImuMeasurement, MagnetometerMeasurement
from agent.wire import dialect as mav

AHEAD_NS = 5_000_000_000  # the agent's clock against the sensors' in real time


class Sea:
    """A boat in the hands of a node, with the link between them that can be cut."""

    def __init__(self, mode: int) -> None:
        self.host = Host(silence_s=30.0)
        self.mode = mode
        self.boat = Boat()
        self.sensors = Sensors(7, Noise(gnss_drift_m=0.0))
        self.command: tuple[float, ...] = (0.0, 0.0)
        self.actuators: Any = None
        self.said: list[str] = []
        self.host.clock.time_ns = AHEAD_NS
        self.host.run(START, mode)
        self.host.autopilot.parameters.set("COMPASS_DEC", DECLINATION_RAD)

    # Sensors.feed takes this for an autopilot.

    def on_imu(self, s: ImuMeasurement) -> None:
        self.outgoing.append(mav.MAVLink_xitl_imu_message(s.stamp_ns // 1000, s.gyro_frd_radps, s.accel_frd_mps2, 20.0))

    def on_gnss(self, s: GnssMeasurement) -> None:
        place = round(s.lat_deg * 1e7), round(s.lon_deg * 1e7), round(s.alt_m * 1e3)
        accuracy = s.horizontal_accuracy_m, s.vertical_accuracy_m, s.speed_accuracy_mps
        self.outgoing.append(
            mav.MAVLink_xitl_gnss_message(
                s.stamp_ns // 1000, *place, s.vel_ned_mps, *accuracy, s.fix_type, s.satellites
            )
        )

    def on_magnetometer(self, s: MagnetometerMeasurement) -> None:
        self.outgoing.append(mav.MAVLink_xitl_magnetometer_message(s.stamp_ns // 1000, s.field_frd_gauss))

    def on_barometer(self, s: BarometerMeasurement) -> None:
        self.outgoing.append(mav.MAVLink_xitl_barometer_message(s.stamp_ns // 1000, s.pressure_pa, s.temperature_degc))

    def sail(self, seconds: float, link: bool = True) -> None:
        """So long. While the link is cut, the vessel drifts and in lockstep the ticks alone come."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.outgoing: list[Any] = []
            self.sensors.feed(self.boat, self)  # type: ignore[arg-type]
            if not link:
                self.outgoing.clear()
            if self.mode == LOCKSTEP and self.boat.time_ns % (20 * MS) == 0:
                stamp_us = self.boat.time_ns // 1000
                self.outgoing.append(mav.MAVLink_xitl_tick_message(stamp_us, stamp_us // 20_000))
            self.host.clock.time_ns = self.boat.time_ns + AHEAD_NS
            heard = self.host.send(*self.outgoing)
            for actuators in of("XITL_ACTUATORS", heard):
                self.actuators = actuators
                if link:
                    self.command = tuple(actuators.command[:2])
            self.said += texts(heard)
            self.boat.step(self.command if link else (0.0, 0.0))

    def set_out(self) -> None:
        self.sail(12.0)
        autopilot = self.host.autopilot
        autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(300.0, 0.0))]))
        assert autopilot.set_mode(modes.AUTO) == ""
        assert autopilot.arm() == ()
        self.sail(10.0)

    @property
    def flags(self) -> int:
        return int(self.actuators.flags)


ARMED, FAILSAFE = mav.XITL_ACTUATOR_FLAGS_ARMED, mav.XITL_ACTUATOR_FLAGS_FAILSAFE


@pytest.mark.medium
@pytest.mark.parametrize("mode", [LOCKSTEP, REALTIME])
def test_a_cut_of_five_seconds_and_on_with_the_mission(mode: int) -> None:
    sea = Sea(mode)
    sea.set_out()
    assert sea.flags == ARMED
    assert sea.boat.north_m > 5.0
    timeout_s = sea.host.autopilot.parameters["FS_IMU_TIMEOUT"]
    sea.sail(timeout_s - 0.1, link=False)
    assert sea.flags == ARMED
    sea.sail(5.1 - timeout_s, link=False)
    assert sea.flags == ARMED | FAILSAFE
    assert list(sea.actuators.command) == [0.0] * 8
    sea.sail(2.0)
    assert sea.flags == ARMED
    assert max(sea.command) > 0.1
    sea.sail(20.0)
    autopilot = sea.host.autopilot
    assert autopilot.state.armed
    assert autopilot.state.mode == modes.AUTO
    assert sea.boat.north_m > 25.0
    assert abs(sea.boat.east_m) < 3.0
    assert sum(text.startswith("Failsafe: no IMU") for text in sea.said) == 1
    assert sum(text.startswith("Failsafe over") for text in sea.said) == 1


@pytest.mark.medium
def test_when_the_host_dies_it_ends_neutral_and_in_the_end_disarmed() -> None:
    sea = Sea(REALTIME)
    sea.set_out()
    sea.sail(1.0, link=False)
    assert sea.flags == ARMED | FAILSAFE
    assert list(sea.actuators.command) == [0.0] * 8
    sea.sail(31.0, link=False)
    assert sea.flags == 0
    assert list(sea.actuators.command) == [0.0] * 8
    assert not sea.host.autopilot.state.armed
