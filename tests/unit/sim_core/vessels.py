"""Vessels under test: the full-size ASV and its 1/3 Froude-scaled sister."""

from __future__ import annotations

from dataclasses import replace

from sim_core.vessel.model import AddedMass, Damping, Hull, Propeller, VesselModel, Windage

LINEAR = Damping(surge=15.0, sway=250.0, heave=500.0, roll=50.0, pitch=50.0, yaw=150.0)
QUADRATIC = Damping(surge=20.0, sway=150.0, yaw=200.0)


def propeller(side: float) -> Propeller:
    return Propeller((-0.7, 0.5 * side, -0.55), 250.0, 150.0, 0.25, 0.4)


FULL = VesselModel(
    name="asv-full",
    mass_kg=113.0,
    inertia_kgm2=(23.0, 35.0, 56.0),
    hull=Hull(length_m=2.3, width_m=1.6, radius_m=0.2, keel_below_cg_m=0.25, strips=6),
    added_mass=AddedMass(surge_kg=5.1, sway_kg=72.0, heave_kg=216.0, roll_kgm2=78.0, pitch_kgm2=95.0, yaw_kgm2=34.0),
    damping_linear=LINEAR,
    damping_quadratic=QUADRATIC,
    propellers=(propeller(-1.0), propeller(1.0)),
    wind=Windage(0.9, 1.3, 2.3, 0.7, 0.9, 0.1),
)

BARE = replace(FULL, name="bare", added_mass=AddedMass(), wind=Windage())
