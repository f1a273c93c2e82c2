"""Parameters for another autopilot: what its files say, what the profile implies, and what the profile sets."""

from __future__ import annotations

from collections.abc import Iterable

from agent.fcu.parameters import ParameterError, parm_lines
from xitl_cli.errors import UserError
from xitl_cli.profile.parameter_files import find_parameter_file
from xitl_cli.profile.schema import RunProfile

EXTERNAL_AHRS_PROTOCOL = 36  # SERIALn_PROTOCOL
SERIAL_PORTS = range(10)


def file_values(names: Iterable[str]) -> dict[str, float]:
    """Values of parameter files, later ones over earlier ones. Raises UserError for a file that is none."""
    values: dict[str, float] = {}
    for name in names:
        path = find_parameter_file(name)
        try:
            values.update({key: value for _, key, value in parm_lines(path.read_text(encoding="utf-8"), str(path))})
        except (OSError, UnicodeDecodeError, ParameterError) as error:
            raise UserError(str(error)) from error
    return values


def implied_values(profile: RunProfile) -> dict[str, float]:
    """What mission and sensors imply, by ArduPilot's names."""
    values = {"WP_SPEED": profile.mission.speed_mps, "WP_RADIUS": profile.mission.acceptance_radius_m}
    if profile.sensors is not None:
        values.update(_place("INS_POS1", profile.sensors.imu.position_frd_m))
        if profile.autopilot.bridge.sensors is not None:
            values.update(_place("GPS1_POS", profile.sensors.gnss.antenna_frd_m))
    return values


def own_values(profile: RunProfile) -> dict[str, float]:
    """What a live autopilot is held to: what the profile implies, and over that what it sets."""
    if profile.autopilot.kind != "ardupilot":
        return dict(profile.autopilot.parameters)
    return implied_values(profile) | dict(profile.autopilot.parameters)


def start_values(profile: RunProfile) -> dict[str, float]:
    """All that an autopilot which is started here begins with. Raises UserError."""
    return file_values(profile.autopilot.parameter_files) | own_values(profile)


def serial_port_of(values: dict[str, float], protocol: int = EXTERNAL_AHRS_PROTOCOL) -> int | None:
    """The lowest serial port with this protocol, None when there is none."""
    ports = (port for port in SERIAL_PORTS if values.get(f"SERIAL{port}_PROTOCOL") == protocol)
    return next(ports, None)


def parm_text(values: dict[str, float]) -> str:
    """A parameter file, as the autopilot reads it at its start."""
    return "".join(f"{name} {value:.9g}\n" for name, value in sorted(values.items()))


def _place(name: str, position_frd_m: tuple[float, float, float]) -> dict[str, float]:
    return {f"{name}_{axis}": value for axis, value in zip("XYZ", position_frd_m, strict=True)}
