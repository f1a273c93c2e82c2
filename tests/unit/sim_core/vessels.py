"""Vessels under test: the full-size ASV and its 1/3 Froude-scaled sister."""

from __future__ import annotations

from dataclasses import asdict, replace

from sim_core.vessel.spec import AddedMass, Damping, Hull, Propeller, VesselSpec, Windage

LINEAR = Damping(surge=15.0, sway=250.0, heave=500.0, roll=230.0, pitch=270.0, yaw=150.0)
QUADRATIC = Damping(surge=20.0, sway=150.0, yaw=200.0)


def propeller(side: float) -> Propeller:
    return Propeller((-0.7, 0.5 * side, -0.55), 250.0, 150.0, 0.25, 0.4)


FULL = VesselSpec(
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


def froude_scaled(model: VesselSpec, scale: float) -> VesselSpec:
    """The same vessel with lengths times `scale`, in the same water and gravity: time goes with its root."""

    def damping(values: Damping, force: float) -> Damping:
        turning = ("roll", "pitch", "yaw")  # a moment has one length more, an angular rate one length less
        return Damping(**{k: v * scale ** (force + 2.0 * (k in turning)) for k, v in asdict(values).items()})

    # A quadratic moment coefficient: lambda^4 over (lambda^-1/2)^2.
    quadratic = damping(model.damping_quadratic, 2.0)
    quadratic = replace(quadratic, yaw=model.damping_quadratic.yaw * scale**5)
    masses = {k: v * scale ** (3 if k.endswith("_kg") else 5) for k, v in asdict(model.added_mass).items()}
    hull = model.hull
    return VesselSpec(
        name=f"{model.name}-{scale:.3g}",
        mass_kg=model.mass_kg * scale**3,
        inertia_kgm2=tuple(value * scale**5 for value in model.inertia_kgm2),
        hull=Hull(
            length_m=hull.length_m * scale,
            width_m=hull.width_m * scale,
            radius_m=hull.radius_m * scale,
            keel_below_cg_m=hull.keel_below_cg_m * scale,
            strips=hull.strips,
        ),
        added_mass=AddedMass(**masses),
        damping_linear=damping(model.damping_linear, 2.5),
        damping_quadratic=quadratic,
        propellers=tuple(
            Propeller(
                position_frd_m=tuple(x * scale for x in p.position_frd_m),
                max_thrust_n=p.max_thrust_n * scale**3,
                max_reverse_thrust_n=p.max_reverse_thrust_n * scale**3,
                spin_up_s=p.spin_up_s * scale**0.5,
                spin_down_s=p.spin_down_s * scale**0.5,
            )
            for p in model.propellers
        ),
        wind=replace(
            model.wind,
            frontal_area_m2=model.wind.frontal_area_m2 * scale**2,
            lateral_area_m2=model.wind.lateral_area_m2 * scale**2,
            length_m=model.wind.length_m * scale,
        ),
    )
