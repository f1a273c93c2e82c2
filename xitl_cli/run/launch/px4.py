"""The PX4 that a run starts: its instance, which gives its ports, its parameters and its directory."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_px4
from xitl_cli.firmware.process import FirmwareProcess
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import MOST_PX4_INSTANCES, PX4_MAVLINK_PORT, PX4_SIMULATOR_PORT, BridgeSpec
from xitl_cli.run.core.directory import AUTOPILOT, ULOG
from xitl_cli.run.links.ports import PortClaims, is_free
from xitl_cli.run.links.setup import start_parameters

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
