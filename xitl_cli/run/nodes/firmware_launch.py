"""The autopilot that a profile has started here: its ports, its command line, its parameters, its directory."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_firmware
from xitl_cli.firmware.process import FirmwareProcess
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import BridgeSpec
from xitl_cli.run.core.directory import AUTOPILOT, DATAFLASH
from xitl_cli.run.links.ports import PortClaims
from xitl_cli.run.links.setup import EXTERNAL_AHRS_PROTOCOL, parameter_file_text, serial_port_with, start_parameters
from xitl_cli.shipped import firmware_params_dir

PARAMETERS = "parameters.parm"
SCRIPTS = "scripts"  # where a SITL build looks for them
LISTENS_S = 10.0
AIS_PROTOCOL, AIS_PORTS = 40, (5, 6, 7)  # those that a SITL gives to nothing else
STATION_PORTS = (1, 2)  # SERIAL1 and SERIAL2 speak MAVLink unless told otherwise
SCRIPTING = {"SCR_ENABLE": 1, "SCR_SDEV_EN": 1, "SCR_SDEV1_PROTO": EXTERNAL_AHRS_PROTOCOL}
SPEEDUP = 200  # as fast as the world comes
_LISTENS = ("SERIAL0 on TCP port", "Waiting for connection", "Loaded defaults")


def resolved_bridge(bridge: BridgeSpec, ports: PortClaims) -> BridgeSpec:
    """Port 0 in an address of the bridge is one that is free."""

    def free(url: str | None) -> str | None:
        return None if url is None else ports.free_url(url)

    return replace(
        bridge, mavlink=ports.free_url(bridge.mavlink), world=free(bridge.world), sensor_link=free(bridge.sensor_link)
    )


class FirmwareLaunch:
    """Starts the firmware of `profile`; `bridge` has the ports of the bridge, `ground_stations` theirs.

    rc_port: where it may hear radio control, which nobody sends. ais: where it calls for AIS sentences.

    Raises UserError when there is no firmware, or its parameters keep it from taking our sensors.
    """

    log_name = DATAFLASH
    log_suffix = ".bin"

    def __init__(
        self,
        profile: RunProfile,
        bridge: BridgeSpec,
        rc_port: int,
        ground_stations: tuple[str, ...] = (),
        ais: str | None = None,
    ) -> None:
        autopilot = profile.autopilot
        self.program = find_firmware("rover", autopilot.firmware_build, autopilot.firmware)
        self._profile = profile
        self.bridge = bridge
        self._ground_stations = ground_stations
        self._rc_port = rc_port
        self._values = start_parameters(profile) | _system_parameters(autopilot.system_id)
        self._ais = ais
        if ais is not None:
            self._values |= {f"SERIAL{self._ais_port()}_PROTOCOL": AIS_PROTOCOL, "AIS_TYPE": 1}
        if bridge.sensors == "hil":
            self._check_scripting()

    def start(self, run_directory: Path) -> FirmwareProcess:
        """In `autopilot/` of the run's directory, which is made anew. Raises UserError."""
        directory = run_directory.absolute() / AUTOPILOT
        try:
            shutil.rmtree(directory, ignore_errors=True)
            directory.mkdir(parents=True)
            (directory / PARAMETERS).write_text(parameter_file_text(self._values))
            if self.bridge.sensors == "hil":
                shutil.copytree(firmware_params_dir() / "lua", directory / SCRIPTS)
        except OSError as error:
            raise UserError(f"{directory}: cannot be made ({error.strerror}); choose another --out") from error
        process = FirmwareProcess(self.program, self.arguments(), directory)
        if self._profile.autopilot.firmware_build == "sitl":
            process.wait_for(*_LISTENS, timeout_s=LISTENS_S)
        return process

    def end(self) -> None:
        """There is nothing to give back."""

    def arguments(self) -> list[str]:
        """Its command line."""
        autopilot = self._profile.autopilot
        own = self._sitl() if autopilot.firmware_build == "sitl" else self._linux()
        return [*own, "--defaults", PARAMETERS, *autopilot.firmware_arguments]

    def _sitl(self) -> list[str]:
        profile, world = self._profile, self.bridge.world
        site, start = profile.site, profile.mission.start
        place = (site.latitude_deg, site.longitude_deg, site.altitude_m, start.heading_deg)
        words = ["--home", ",".join(f"{value:.9f}" for value in place)]
        if world is None:
            words += ["--model", "motorboat"]
        else:
            parts = urlsplit(world)
            words += ["--model", "JSON:127.0.0.1", "--sim-port-out", str(parts.port), "--speedup", str(SPEEDUP)]
        words += ["--rc-in-port", str(self._rc_port)]
        serial = {0: f"tcp:{urlsplit(self.bridge.mavlink).port}", 1: "none:", 2: "none:"}
        for port, address in self._stations():
            serial[port] = (
                f"tcp:{address.port}" if address.scheme == "tcp" else f"udpclient:{address.hostname}:{address.port}"
            )
        if self.bridge.sensor_link is not None:
            port, parts = self._sensor_port(), urlsplit(self.bridge.sensor_link)
            serial[port] = f"uart:{parts.path}:{_baud(parts)}" if parts.scheme == "serial" else f"tcp:{parts.port}"
        if self._ais is not None:
            serial[self._ais_port()] = f"tcpclient:127.0.0.1:{urlsplit(self._ais).port}"
        return words + _serial_words(serial)

    def _linux(self) -> list[str]:
        words = ["--log-directory", "logs", "--storage-directory", ".", "--terrain-directory", "."]
        serial = {0: _linux_path(self.bridge.mavlink)}
        for port, address in self._stations():
            where = "*" if address.hostname == "0.0.0.0" else address.hostname
            serial[port] = f"{address.scheme}:{where}:{address.port}"
        if self.bridge.sensor_link is not None:
            serial[self._sensor_port()] = _linux_path(self.bridge.sensor_link, waits=True)
        return words + _serial_words(serial)

    def _check_scripting(self) -> None:
        """With the driver on and nothing at its other end, ArduPilot crashes as it starts."""
        for name, wanted in SCRIPTING.items():
            value = self._values.get(name, 0.0)
            if value != wanted:
                raise UserError(
                    f"autopilot.parameters.{name} = {value:g}: autopilot.bridge.sensors = hil needs {wanted}, for the "
                    "script that takes them; leave it as parameter file rover-hil has it"
                )

    def _stations(self) -> Iterator[tuple[int, SplitResult]]:
        """Its serial ports for ground stations, and their addresses."""
        taken = serial_port_with(self._values)
        ports = (port for port in STATION_PORTS if port != taken)
        return zip(ports, map(urlsplit, self._ground_stations), strict=False)

    def _ais_port(self) -> int:
        """The one that its parameters name for AIS, else the first that they leave alone."""
        named = serial_port_with(self._values, AIS_PROTOCOL)
        free = (port for port in AIS_PORTS if f"SERIAL{port}_PROTOCOL" not in self._values)
        return next(free, AIS_PORTS[-1]) if named is None else named

    def _sensor_port(self) -> int:
        port = serial_port_with(self._values)
        if port is None:
            raise UserError(
                f"autopilot.parameter_files: no serial port of the autopilot has SERIALn_PROTOCOL = "
                f"{EXTERNAL_AHRS_PROTOCOL}, so autopilot.bridge.sensor_link leads nowhere; set one, "
                "for instance SERIAL4_PROTOCOL"
            )
        return port


def _system_parameters(system_id: int) -> dict[str, float]:
    """Its MAVLink system by the name of each version: it passes over those that it does not know. It is 1 by itself."""
    return {} if system_id == 1 else dict.fromkeys(("MAV_SYSID", "SYSID_THISMAV"), float(system_id))


def _linux_path(url: str, waits: bool = False) -> str:
    """How ArduPilot's Linux builds name the other end: they serve TCP, wait for UDP, open a device."""
    parts = urlsplit(url)
    if parts.scheme == "serial":
        return parts.path
    if parts.scheme == "udp":
        return f"udpin:{parts.hostname}:{parts.port}"
    return f"tcp:{parts.hostname}:{parts.port}" + (":wait" if waits else "")


def _serial_words(serial: dict[int, str]) -> list[str]:
    return [word for port, path in sorted(serial.items()) for word in (f"--serial{port}", path)]


def _baud(parts: SplitResult) -> str:
    query = dict(word.partition("=")[::2] for word in parts.query.split("&"))
    return query.get("baud", "921600")
