"""The navigation solution of a simulated unit: our sensors through our own estimator, so that its errors are honest."""

from __future__ import annotations

import math

from agent.bridges.declination import declination_rad
from agent.bridges.gps_time import GpsTime
from agent.bridges.samples import Navigation, ReceiverFix
from agent.fcu.parameters import Parameters
from agent.fcu.samples import BarometerSample, GnssSample, ImuSample, MagnetometerSample
from agent.fcu.sensing.estimator import Estimator

TILT_ACCURACY_DEG, HEADING_ACCURACY_DEG = 0.5, 2.0  # what the estimator keeps at sea; it has no covariance of attitude


class NavigationSolution:
    """Samples in; `newest` is the solution at the newest inertial sample.

    It knows of no lever arms: the place is that of the antenna. The declination is found with the first fix.
    """

    def __init__(self, time: GpsTime) -> None:
        self._time = time
        self._parameters = Parameters()
        self._estimator = Estimator(self._parameters)
        self._fix: ReceiverFix | None = None

    def on_imu(self, sample: ImuSample) -> None:
        """A sample that cannot be true is passed over, as by the others."""
        self._estimator.on_imu(sample)

    def on_magnetometer(self, sample: MagnetometerSample) -> None:
        """Field, FRD."""
        self._estimator.on_magnetometer(sample)

    def on_barometer(self, sample: BarometerSample) -> None:
        """Pressure."""
        self._estimator.on_barometer(sample)

    def on_fix(self, fix: ReceiverFix) -> None:
        """A fix of the receiver, as late as it comes."""
        accepted = self._estimator.on_gnss(
            GnssSample(
                fix.stamp_ns,
                fix.lat_deg,
                fix.lon_deg,
                fix.alt_m,
                fix.vel_ned_mps,
                fix.horizontal_accuracy_m,
                fix.vertical_accuracy_m,
                fix.speed_accuracy_mps,
                fix.fix_type,
                fix.satellites,
            )
        )
        if not accepted or fix.fix_type < 3:
            return
        if self._fix is None:
            year = self._time.year_at(fix.stamp_ns)
            self._parameters.set("COMPASS_DEC", declination_rad(fix.lat_deg, fix.lon_deg, fix.alt_m, year))
            self._estimator.configure()
        self._fix = fix

    def newest(self) -> Navigation | None:
        """None before attitude and place are known, and while they are lost."""
        frame, fix = self._estimator.frame, self._fix
        if frame is None or fix is None:
            return None
        e = self._estimator.estimate()
        if not (e.attitude_valid and e.position_valid):
            return None
        north, east, down = e.pos_ned_m
        lat_deg, lon_deg = frame.to_geodetic(north, east)
        return Navigation(
            e.stamp_ns,
            fix.gps_ns,
            e.quat_ned_frd,
            (e.roll_rad, e.pitch_rad, math.remainder(e.yaw_rad, 2.0 * math.pi)),
            lat_deg,
            lon_deg,
            frame.alt_m - down,
            e.vel_ned_mps,
            TILT_ACCURACY_DEG,
            HEADING_ACCURACY_DEG,
            fix.horizontal_accuracy_m,
            fix.vertical_accuracy_m,
            fix.speed_accuracy_mps,
        )
