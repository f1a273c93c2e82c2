"""A vessel to run into things with: the full-size catamaran without windage."""

from __future__ import annotations

from sim_core.vessel.spec import AddedMass, Damping, Hull, Propeller, VesselSpec

ASV = VesselSpec(
    name="asv",
    mass_kg=113.0,
    inertia_kgm2=(23.0, 35.0, 56.0),
    hull=Hull(length_m=2.3, width_m=1.6, radius_m=0.2, keel_below_cg_m=0.25, strips=6),
    added_mass=AddedMass(surge_kg=5.1, sway_kg=72.0, heave_kg=216.0, roll_kgm2=78.0, pitch_kgm2=95.0, yaw_kgm2=34.0),
    damping_linear=Damping(surge=15.0, sway=250.0, heave=500.0, roll=230.0, pitch=270.0, yaw=150.0),
    damping_quadratic=Damping(surge=20.0, sway=150.0, yaw=200.0),
    propellers=tuple(Propeller((-0.7, side, -0.55), 250.0, 150.0, 0.25, 0.4) for side in (-0.5, 0.5)),
)
