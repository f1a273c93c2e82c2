"""Sensors: each is a frozen model with `initial(vessels, rng)` and `measure(state, truth, rng)`.

A sensor is measured once every `1 / rate_hz`; its noise is discretised for that step. `latency_s` is the delay between
the instant a sample is valid for and its delivery. The code that delivers the samples applies it; the sensor does not.
"""
