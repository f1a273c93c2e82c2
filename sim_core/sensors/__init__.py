"""Sensors: each a frozen model with `initial(vessels, rng)` and `measure(state, truth, rng)`.

A sensor is measured once every `1 / rate_hz`; its noise is discretised for that step. `latency_s` is the delay between
the instant a sample is valid for and its delivery: the one who delivers samples applies it, never the sensor itself.
"""

from sim_core.sensors.barometer import Barometer, BarometerSample, BarometerState
from sim_core.sensors.gnss import Gnss, GnssSample, GnssState
from sim_core.sensors.imu import Imu, ImuSample, ImuState
from sim_core.sensors.magnetometer import (
    LocalField,
    Magnetometer,
    MagnetometerSample,
    MagnetometerState,
    local_field_ned_gauss,
)

__all__ = [
    "Barometer",
    "BarometerSample",
    "BarometerState",
    "Gnss",
    "GnssSample",
    "GnssState",
    "Imu",
    "ImuSample",
    "ImuState",
    "LocalField",
    "Magnetometer",
    "MagnetometerSample",
    "MagnetometerState",
    "local_field_ned_gauss",
]
