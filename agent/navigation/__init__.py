"""Measurements, geodesy, GPS time and the estimator.

The embedded autopilot (LS), the simulated navigation units of the bridges and the companion use them.
"""
