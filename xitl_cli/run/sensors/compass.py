"""The heading error of a compass without calibration of its hard iron."""

from __future__ import annotations

import math
from collections.abc import Sequence

from xitl_cli.profile.schema.profile import RunProfile
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.world.world import magnetic_field_ned_gauss

WORTH_SAYING_DEG = 1.5
"""Threshold for a warning. A calibrated compass, also that of the shipped boats at their site, has about one degree
left.
"""


def uncalibrated_heading_deg(residual_frd_gauss: Sequence[float], field_ned_gauss: Sequence[float]) -> float:
    """Return the largest heading error of a level vessel, in degrees.

    residual_frd_gauss (3,): hard iron with the compass offsets. It turns with the vessel. The measured horizontal field
    therefore swings about the true field by at most asin(residual / field). The result is 180 if the residual is larger
    than the field.
    """
    residual, field = math.hypot(*residual_frd_gauss[:2]), math.hypot(*field_ned_gauss[:2])
    return math.degrees(math.asin(residual / field)) if residual < field else 180.0


def compass_warnings(profiles: Sequence[RunProfile]) -> list[str]:
    """Return a sentence for each vessel of the embedded autopilot with a larger compass error than calibrations leave.

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
