"""The autopilot that a run starts: its ports, command line, parameters and directory."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_firmware, find_px4
from xitl_cli.firmware.process import FirmwareProcess
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import MOST_PX4_INSTANCES, PX4_MAVLINK_PORT, PX4_SIMULATOR_PORT, BridgeSpec
from xitl_cli.run.core.directory import AUTOPILOT, DATAFLASH, ULOG
from xitl_cli.run.links.ports import PortClaims, is_free
from xitl_cli.run.links.setup import EXTERNAL_AHRS_PROTOCOL, parameter_file_text, serial_port_with, start_parameters
from xitl_cli.shipped import firmware_params_dir

PARAMETERS = "parameters.parm"
SCRIPTS = "scripts"  # folder in which a SITL build looks for scripts
LISTENS_S = 10.0
AIS_PROTOCOL, AIS_PORTS = 40, (5, 6, 7)  # ports that a SITL leaves unused
STATION_PORTS = (1, 2)  # SERIAL1 and SERIAL2 use MAVLink by default
SCRIPTING = {"SCR_ENABLE": 1, "SCR_SDEV_EN": 1, "SCR_SDEV1_PROTO": EXTERNAL_AHRS_PROTOCOL}
SPEEDUP = 200  # high enough that the world sets the pace
_LISTENS = ("SERIAL0 on TCP port", "Waiting for connection", "Loaded defaults")


def resolved_bridge(bridge: BridgeSpec, ports: PortClaims) -> BridgeSpec:
    """Replace port 0 in addresses of the bridge by free ports."""

    def free(url: str | None) -> str | None:
        return None if url is None else ports.free_url(url)

    return replace(
        bridge, mavlink=ports.free_url(bridge.mavlink), world=free(bridge.world), sensor_link=free(bridge.sensor_link)
    )


class FirmwareLaunch:
    """Starts the firmware of `profile`. `bridge` has the ports of the bridge, `ground_stations` those of the stations.

    rc_port: port for radio control, which receives nothing. ais: address to which it connects for AIS sentences.

    Raises UserError without a firmware, or when its parameters do not allow the simulated sensors.
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
        self._values = start_parameters(profile)
        if autopilot.system_id != 1:  # the names of all versions, of which each ignores the unknown one
            self._values |= dict.fromkeys(("MAV_SYSID", "SYSID_THISMAV"), float(autopilot.system_id))
        self._ais = ais
        if ais is not None:
            self._values |= {f"SERIAL{self._ais_port()}_PROTOCOL": AIS_PROTOCOL, "AIS_TYPE": 1}
        if bridge.sensors != "hil":
            return
        # With the driver on and no script at its other end, ArduPilot crashes at its start.
        for name, required in SCRIPTING.items():
            value = self._values.get(name, 0.0)
            if value != required:
                raise UserError(
                    f"autopilot.parameters.{name} = {value:g}: autopilot.bridge.sensors = hil needs {required} for its "
                    "script; remove the value, so that parameter file rover-hil sets it"
                )

    def start(self, run_directory: Path) -> FirmwareProcess:
        """Start it in a new folder `autopilot/` of the run's directory. Raises UserError."""
        directory = run_directory.absolute() / AUTOPILOT
        try:
            shutil.rmtree(directory, ignore_errors=True)
            directory.mkdir(parents=True)
            (directory / PARAMETERS).write_text(parameter_file_text(self._values), encoding="utf-8")
            if self.bridge.sensors == "hil":
                shutil.copytree(firmware_params_dir() / "lua", directory / SCRIPTS)
        except OSError as error:
            raise UserError(f"{directory} cannot be created ({error.strerror}); choose another --out") from error
        process = FirmwareProcess(self.program, self.arguments(), directory)
        if self._profile.autopilot.firmware_build == "sitl":
            process.wait_for(*_LISTENS, timeout_s=LISTENS_S)
        return process

    def end(self) -> None:
        """Do nothing: there is nothing to release."""

    def arguments(self) -> list[str]:
        """Return the command line."""
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
            query = dict(word.partition("=")[::2] for word in parts.query.split("&"))
            device = f"uart:{parts.path}:{query.get('baud', '921600')}"
            serial[port] = device if parts.scheme == "serial" else f"tcp:{parts.port}"
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

    def _stations(self) -> Iterator[tuple[int, SplitResult]]:
        """Yield the serial ports for ground stations with their addresses."""
        taken = serial_port_with(self._values)
        ports = (port for port in STATION_PORTS if port != taken)
        return zip(ports, map(urlsplit, self._ground_stations), strict=False)

    def _ais_port(self) -> int:
        """Return the port that the parameters use for AIS, otherwise the first unused one."""
        named = serial_port_with(self._values, AIS_PROTOCOL)
        free = (port for port in AIS_PORTS if f"SERIAL{port}_PROTOCOL" not in self._values)
        return next(free, AIS_PORTS[-1]) if named is None else named

    def _sensor_port(self) -> int:
        port = serial_port_with(self._values)
        if port is None:
            raise UserError(
                f"autopilot.parameter_files: no serial port of the autopilot has SERIALn_PROTOCOL = "
                f"{EXTERNAL_AHRS_PROTOCOL} for autopilot.bridge.sensor_link; set one, for instance SERIAL4_PROTOCOL"
            )
        return port


def _linux_path(url: str, waits: bool = False) -> str:
    """Return the name of the other end for ArduPilot's Linux builds, which serve TCP, wait for UDP or open a device."""
    parts = urlsplit(url)
    if parts.scheme == "serial":
        return parts.path
    if parts.scheme == "udp":
        return f"udpin:{parts.hostname}:{parts.port}"
    return f"tcp:{parts.hostname}:{parts.port}" + (":wait" if waits else "")


def _serial_words(serial: dict[int, str]) -> list[str]:
    return [word for port, path in sorted(serial.items()) for word in (f"--serial{port}", path)]


LOCAL = "127.0.0.1"
STATION_PORT = 18570  # PX4's port for ground stations; PX4 sends to UDP 14550
AIRFRAME = 1061  # a differential rover with an external simulator; an airframe of PX4 for software only
STARTS_S = 10.0
STARTUP = "startup.sh"
_OWN_SYSTEM = "param set MAV_SYS_ID $((px4_instance+1))"
_CALLS = ("Waiting for simulator", "Simulator connected")


class Px4Launch:
    """Starts the PX4 of `profile`.

    bridge: as in the profile, with the ports of the instance, which is reserved until `end`.

    Raises UserError when there is no PX4, or no instance is free.
    """

    log_name = ULOG
    log_suffix = ".ulg"

    def __init__(self, profile: RunProfile) -> None:
        bridge = profile.autopilot.bridge
        self.program, self._data = find_px4(profile.autopilot.firmware)
        self._profile = profile
        self._ports = PortClaims()
        self.instance = self._reserve(bridge)
        self.bridge = replace(
            bridge,
            mavlink=f"udp://{LOCAL}:{PX4_MAVLINK_PORT + self.instance}",
            sensor_link=f"tcp://{LOCAL}:{PX4_SIMULATOR_PORT + self.instance}",
        )

    @property
    def station_url(self) -> str:
        """The address for its ground station. It sends to UDP 14550 until another station sends to this address."""
        return f"udp://{LOCAL}:{STATION_PORT + self.instance}"

    def start(self, run_directory: Path) -> FirmwareProcess:
        """Start it in a new folder `autopilot/` of the run's directory. Raises UserError."""
        directory = run_directory.absolute() / AUTOPILOT
        try:
            shutil.rmtree(directory, ignore_errors=True)
            directory.mkdir(parents=True)
            startup = self._startup_text()
            if startup is not None:
                (directory / STARTUP).write_text(startup, encoding="utf-8")
        except OSError as error:
            raise UserError(f"{directory} cannot be created ({error.strerror}); choose another --out") from error
        process = FirmwareProcess(self.program, self.arguments(), directory, self.environment())
        process.wait_for(*_CALLS, timeout_s=STARTS_S)
        return process

    def arguments(self) -> list[str]:
        """Return the command line."""
        startup = ["-s", STARTUP] if self._startup_text() is not None else []
        return ["-d", "-i", str(self.instance), *startup, str(self._data), *self._profile.autopilot.firmware_arguments]

    def _startup_text(self) -> str | None:
        """Return a start script with the vessel's system id, or None when the default fits.

        The default of instance i is system i + 1.
        """
        system_id = self._profile.autopilot.system_id
        if system_id == self.instance + 1:
            return None
        text = (self._data / "init.d-posix" / "rcS").read_text(encoding="utf-8")
        return text.replace(_OWN_SYSTEM, f"param set MAV_SYS_ID {system_id}") if _OWN_SYSTEM in text else None

    def environment(self) -> Mapping[str, str]:
        """Return this process's environment without variables for another PX4, and with the parameters.

        PX4 reads some parameters at its start only, and gets them this way.
        """
        values = start_parameters(self._profile)
        airframe = values.pop("SYS_AUTOSTART", AIRFRAME)
        ours = {name: value for name, value in os.environ.items() if not name.startswith("PX4_")}
        parameters = {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in values.items()}
        return ours | parameters | {"PX4_SYS_AUTOSTART": f"{airframe:.0f}"}

    def end(self) -> None:
        """Release the instance. Safe to call again."""
        self._ports.close()

    def _reserve(self, bridge: BridgeSpec) -> int:
        """Reserve the instance of the port in the profile, otherwise the lowest instance with free ports."""
        port = urlsplit(bridge.sensor_link or "").port or 0
        for instance in [port - PX4_SIMULATOR_PORT] if port else range(MOST_PX4_INSTANCES):
            addresses = [
                ("tcp", LOCAL, PX4_SIMULATOR_PORT + instance),
                ("udp", "0.0.0.0", PX4_MAVLINK_PORT + instance),
                ("udp", "0.0.0.0", STATION_PORT + instance),
            ]
            if all(
                is_free(urlsplit(f"{scheme}://{host}:{number}")) and self._ports.claim(scheme, number)
                for scheme, host, number in addresses
            ):
                return instance
            self._ports.close()  # another program or run has one of the ports
        where = f"port {port}" if port else f"the ports from {PX4_SIMULATOR_PORT} on"
        raise UserError(
            f"autopilot.bridge.sensor_link: {where} of this machine, or the other ports of that PX4 instance, are in "
            "use; end the PX4 or the run that uses them"
        )
