"""Comparison of two logs: real and simulated, SITL and HITL, estimate and truth.

pairing (one time line, common stamps) → trajectories, profiles, states → sections
"""
