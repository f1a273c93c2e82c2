"""Advice on a figure that differs from its reference: its importance, and the key of the vessel to change."""

from __future__ import annotations

from xitl_cli.plugins.studies.manoeuvres.validation import (
    ARCHIMEDES,
    HORIZONTAL,
    LINEAR,
    LOITER,
    LONG_WAVES,
    MIRRORED,
    STRIPS,
    SURGE_ALONE,
    ValidatedFigure,
)

_MUCH = 3.0
"""Number of tolerances up to which an omission in a closed form explains a difference."""

_MATTERS = {
    ARCHIMEDES: "draft and trim shift drag, windage and natural periods",
    SURGE_ALONE: "it shows in the times of missions and in distances to stop",
    HORIZONTAL: "it shows where the boat turns at waypoints, not on straight legs",
    MIRRORED: "the boat turns better to one side, which an autopilot has to steer against",
    LINEAR: "it shows in seas near the natural period, not in still water",
    STRIPS: "it shows in seas of this wavelength alone",
    LONG_WAVES: "the boat does not follow a swell",
    LOITER: "it shows where the boat holds a place, not under way",
}
_PUBLISHED = "results are no longer those of the published vessel"

_CHANGE = {
    ARCHIMEDES: "check vehicle.mass_kg and vehicle.centre_of_gravity_frd_m, and raise `strips` of the hulls: the "
    "closed form has whole hulls",
    SURGE_ALONE: "look at the trim at top speed in `xitl vehicle check`. Lower the lever between thrust "
    "(vehicle.propellers.N.position_frd_m) and drag, as the closed form is level",
    HORIZONTAL: "look at the heel in the turn in `xitl vehicle check`. Lower vehicle.centre_of_gravity_frd_m or raise "
    "vehicle.damping_linear.roll, as the closed form neither heels nor trims",
    MIRRORED: "give propellers and rudders of both sides the same thrust and angle and opposite second coordinates, "
    "and the centre of gravity 0 there; leave it if the boat is like that",
    LINEAR: "lower the quadratic damping of this motion (vehicle.damping_quadratic), or give hulls that change less "
    "about the waterline, as the closed form has small motions; a decay test of the boat tells which is right",
    STRIPS: "raise the damping of this motion (vehicle.damping_linear) if its damping ratio is under 0.1, or `strips` "
    "of the hulls for short waves",
    LONG_WAVES: "check vehicle.inertia_kgm2 and vehicle.added_mass: both count little in long waves",
    LOITER: "raise max_thrust_n against wind and current, or LOIT_RADIUS in autopilot.parameters",
}
_RESTORE = "compare the file with docs/vehicles.md, or give your vessel a name of its own (vehicle.name)"


def advice(figure: ValidatedFigure) -> str:
    """Return the importance of a difference and the key to change, in sentences; empty for a figure that agrees."""
    if figure.agrees is not False or figure.reference is None:
        return ""
    source = figure.reference.source
    matters, change = _MATTERS.get(source, _PUBLISHED), _CHANGE.get(source, _RESTORE)
    if figure.error is None:
        return f"It matters: the manoeuvre never reached it. To change it, {change}."
    times = abs(figure.error) / figure.reference.allowed if figure.reference.allowed else float("inf")
    weight = "It hardly matters" if times <= _MUCH else "It matters"
    return f"{weight}, {times:.2g} times its tolerance off: {matters}. To change it, {change}."
