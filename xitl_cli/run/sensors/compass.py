"""The heading error of a compass whose hard iron no calibration has taken off."""

from __future__ import annotations

import math
from collections.abc import Sequence

from xitl_cli.profile.schema.profile import RunProfile
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.world.world import magnetic_field_ned_gauss

WORTH_SAYING_DEG = 1.5
"""A calibrated compass has about one degree left, which is also what the shipped boats have at the shipped site."""


def uncalibrated_heading_deg(residual_frd_gauss: Sequence[float], field_ned_gauss: Sequence[float]) -> float:
    """The largest heading error of a level vessel, in degrees.

    residual_frd_gauss (3,): hard iron with the compass offsets. It turns with the vessel, so the measured horizontal
    field swings about the true one by at most asin(residual / field); 180 where the residual is the larger one.
    """
    residual, field = math.hypot(*residual_frd_gauss[:2]), math.hypot(*field_ned_gauss[:2])
    return math.degrees(math.asin(residual / field)) if residual < field else 180.0


def compass_warnings(profiles: Sequence[RunProfile]) -> list[str]:
    """A sentence for each vessel of the embedded autopilot whose compass is off by more than calibrations leave.

    Other autopilots calibrate themselves, or simulate their own compass.
    """
    vessels: dict[str, list[str]] = {}
    for profile in profiles:
        if profile.autopilot.kind != "embedded" or profile.sensors is None:
            continue
        parameters, field = embedded_parameters(profile), magnetic_field_ned_gauss(profile.site)
        iron = profile.sensors.magnetometer.hard_iron_frd_gauss
        residual = [
            part + 1e-3 * parameters.get(f"COMPASS_OFS_{axis}", 0.0) for part, axis in zip(iron, "XYZ", strict=True)
        ]
        if (error_deg := uncalibrated_heading_deg(residual, field)) > WORTH_SAYING_DEG:
            offsets = ", ".join(f"COMPASS_OFS_{axis}={-1e3 * part:.3g}" for part, axis in zip(iron, "XYZ", strict=True))
            text = (
                f"the compass is uncalibrated: {1e3 * math.hypot(*residual[:2]):.1f} mG of hard iron in a horizontal "
                f"field of {1e3 * math.hypot(*field[:2]):.0f} mG turn the heading by up to {error_deg:.1f}°. Calibrate "
                f"it by autopilot.parameters {offsets}, or set sensors.magnetometer.hard_iron_frd_gauss"
            )
            vessels.setdefault(text, []).append(profile.vessel)
    return [f"{', '.join(names)}: {text}" if all(names) else text for text, names in vessels.items()]
