"""Parameters of the estimator, under ArduRover's names. Defaults suit the full-size vessel."""

from __future__ import annotations

import math
from typing import Protocol

from agent.mavlink.parameter_rows import INT8, INT16, Parameter


class EstimatorParameters(Protocol):
    """Values of the rows below by name, such as a dict or the parameters of the embedded autopilot."""

    def __getitem__(self, name: str, /) -> float: ...


ESTIMATOR_ROWS: tuple[Parameter, ...] = (
    Parameter("AHRS_GPS_MINSATS", 6, 0, 30, "", "least number of satellites of a used fix", INT8),
    Parameter("AHRS_RP_P", 0.2, 0.02, 2.0, "1/s", "gain of gravity and GNSS velocity on roll and pitch"),
    Parameter("AHRS_YAW_P", 0.2, 0.02, 2.0, "1/s", "gain of the compass on the heading"),
    Parameter("COMPASS_DEC", 0.0, -math.pi, math.pi, "rad", "magnetic declination, east positive"),
    Parameter("COMPASS_OFS_X", 0.01, -1500.0, 1500.0, "mGauss", "added to the measured field, forward"),
    Parameter("COMPASS_OFS_Y", 0.01, -1500.0, 1500.0, "mGauss", "added to the measured field, right"),
    Parameter("COMPASS_OFS_Z", 0.01, -1500.0, 1500.0, "mGauss", "added to the measured field, down"),
    Parameter("EK3_ABIAS_P_NSE", 0.05, 0.00001, 1.0, "m/s^3", "acceleration bias process noise, at 100 Hz"),
    Parameter("EK3_ACC_P_NSE", 0.2, 0.01, 5.0, "m/s/s", "acceleration process noise, at 100 Hz"),
    Parameter("EK3_ALT_M_NSE", 2.0, 0.1, 50.0, "m", "barometer height noise"),
    Parameter("EK3_GPSDRIFT_TC", 60.0, 1.0, 3600.0, "s", "correlation time of the GNSS position drift"),
    Parameter("EK3_HGT_I_GATE", 500.0, 100.0, 5000.0, "", "height innovation gate, hundredths of sigma", INT16),
    Parameter("EK3_MAGB_M_NSE", 0.005, 0.0, 0.5, "Gauss", "lasting error of an axis of the compass after calibration"),
    Parameter("EK3_MAG_M_NSE", 0.003, 0.0001, 0.5, "Gauss", "noise of an axis of a compass sample"),
    Parameter("EK3_POSNE_M_NSE", 0.15, 0.01, 10.0, "m", "GNSS noise of an axis from fix to fix; the rest is drift"),
    Parameter("EK3_POS_I_GATE", 500.0, 100.0, 5000.0, "", "position innovation gate, hundredths of sigma", INT16),
    Parameter("EK3_VELD_M_NSE", 0.05, 0.01, 5.0, "m/s", "least vertical GNSS velocity noise"),
    Parameter("EK3_VELNE_M_NSE", 0.03, 0.01, 5.0, "m/s", "least horizontal GNSS velocity noise"),
    Parameter("EK3_VEL_I_GATE", 500.0, 100.0, 5000.0, "", "velocity innovation gate, hundredths of sigma", INT16),
    Parameter("GPS1_POS_X", 0.0, -50.0, 50.0, "m", "GNSS antenna forward of the body origin"),
    Parameter("GPS1_POS_Y", 0.0, -50.0, 50.0, "m", "GNSS antenna right of the body origin"),
    Parameter("GPS1_POS_Z", 0.0, -50.0, 50.0, "m", "GNSS antenna below the body origin"),
    Parameter("INS_POS1_X", 0.0, -50.0, 50.0, "m", "IMU forward of the body origin"),
    Parameter("INS_POS1_Y", 0.0, -50.0, 50.0, "m", "IMU right of the body origin"),
    Parameter("INS_POS1_Z", 0.0, -50.0, 50.0, "m", "IMU below the body origin"),
)
