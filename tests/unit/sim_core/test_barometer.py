"""The barometer against the tables of the International Standard Atmosphere."""

import numpy as np
import pytest
from motion import at_rest

from sim_core.sensors.barometer import Barometer, pressure_pa
from sim_core.sensors.spec import BarometerSpec

# ISO 2533:1975 (and US Standard Atmosphere 1976): geopotential altitude, pressure, temperature.
TABLE = [
    (0.0, 101325.0, 15.0),
    (500.0, 95460.8, 11.75),
    (1000.0, 89874.6, 8.5),
    (2000.0, 79495.2, 2.0),
    (5000.0, 54019.9, -17.5),
    (11000.0, 22632.0, -56.5),
]


@pytest.mark.parametrize(("altitude", "pressure", "temperature_degc"), TABLE)
def test_pressure_and_temperature_of_the_table(altitude, pressure, temperature_degc):
    assert float(pressure_pa(np.array(altitude))) == pytest.approx(
        pressure, abs=0.051
    )  # the table is rounded to 0.1 Pa
    barometer = Barometer(BarometerSpec())
    rng = np.random.default_rng(0)
    _, sample = barometer.measure(barometer.initial(1, rng), at_rest(pos_ned_m=(5.0, 7.0, -altitude)), rng)
    assert sample.pressure_pa[0] == pytest.approx(pressure, abs=0.051)
    assert sample.temperature_degc[0] == pytest.approx(temperature_degc)


def test_a_metre_is_the_weight_of_a_metre_of_air():
    drop = pressure_pa(np.array(-0.5)) - pressure_pa(np.array(0.5))
    assert drop == pytest.approx(1.225 * 9.80665, rel=1e-4)  # sea-level density of the ISA


def test_height_counts_from_the_origin_and_the_days_pressure():
    barometer = Barometer(BarometerSpec(), origin_altitude_m=990.0, sea_level_pressure_pa=100000.0)
    rng = np.random.default_rng(0)
    _, sample = barometer.measure(barometer.initial(1, rng), at_rest(pos_ned_m=(0.0, 0.0, -10.0)), rng)
    assert sample.pressure_pa[0] == pytest.approx(89874.6 / 1.01325, rel=1e-6)


def errors(barometer: Barometer, vessels: int, samples: int) -> np.ndarray:
    rng = np.random.default_rng(6)
    state = barometer.initial(vessels, rng)
    record = np.empty((samples, vessels))
    for i in range(samples):
        state, sample = barometer.measure(state, at_rest(vessels), rng)
        record[i] = sample.pressure_pa - 101325.0
    return record


def test_noise_and_drift_are_as_configured():
    noise, drift, correlation_s, rate_hz = 2.0, 5.0, 3.0, 10.0
    barometer = Barometer(
        BarometerSpec(rate_hz=rate_hz, noise_pa=noise, drift_pa=drift, drift_correlation_s=correlation_s)
    )
    record = errors(barometer, vessels=1500, samples=120)
    # 12 s hold two independent values of a process correlated over 3 s: 3000 over all vessels.
    scatter = 4.0 * np.sqrt(2.0 / 3000)
    assert record.var() == pytest.approx(noise**2 + drift**2, rel=scatter)
    for lag in (1, 10, 30):
        covariance = np.mean(record[lag:] * record[:-lag])
        expected = drift**2 * np.exp(-lag / rate_hz / correlation_s)
        assert covariance == pytest.approx(expected, abs=scatter * drift**2), f"lag {lag}"
    first = np.diff(record, axis=0)
    expected = 2.0 * noise**2 + 2.0 * drift**2 * -np.expm1(-1.0 / rate_hz / correlation_s)
    assert first.var() == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 5e4))


def test_noise_alone_is_white():
    record = errors(Barometer(BarometerSpec(noise_pa=1.5)), vessels=100, samples=500)
    assert record.std() == pytest.approx(1.5, rel=4.0 / np.sqrt(2.0 * record.size))
    assert abs(np.mean(record[1:] * record[:-1])) < 5.0 * 1.5**2 / np.sqrt(record.size)


def test_output_comes_in_steps():
    record = errors(Barometer(BarometerSpec(noise_pa=3.0, resolution_pa=0.5)), vessels=20, samples=50)
    np.testing.assert_allclose(record / 0.5, np.rint(record / 0.5), atol=1e-9)
    assert len(np.unique(np.rint(record / 0.5))) > 20


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("rate_hz", 0.0),
        ("noise_pa", -1.0),
        ("drift_correlation_s", 0.0),
        ("origin_altitude_m", 12000.0),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=rf"Barometer(Spec)?\.{field} = .*; use"):
        Barometer(BarometerSpec(), value) if field == "origin_altitude_m" else BarometerSpec(**{field: value})


def test_a_day_without_pressure_is_refused():
    with pytest.raises(ValueError, match=r"Barometer\.sea_level_pressure_pa = 0.0"):
        Barometer(BarometerSpec(), sea_level_pressure_pa=0.0)
