"""What an agent that this machine starts is told at its start; a board's agent has its own command line."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from agent.options import BRIDGE, COMPANION
from xitl_cli.profile.ground_stations import ground_stations_of
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.operation import Bridge


@dataclass(frozen=True, slots=True)
class AgentOptions:
    """The agent's own options, see `xitl agent --help`. `log_dir` is where its DataFlash log goes, None for no log.

    `bridge`: it is one to another autopilot. `companion`: it is a companion computer.
    """

    ground_stations: tuple[str, ...] = ()
    controller: str | None = None
    signing_key_file: str | None = None
    link_key_file: str | None = None
    log_dir: Path | None = None
    bridge: Bridge | None = None
    companion: bool = False

    @property
    def key(self) -> str:
        """The profile's group that it comes from."""
        return "companion" if self.companion else "autopilot"

    def arguments(self) -> list[str]:
        """The same as a command line."""
        given = [("--gcs", url) for url in self.ground_stations]
        others = {
            "--controller": self.controller,
            "--signing-key": self.signing_key_file,
            "--link-key": self.link_key_file,
            "--log-dir": self.log_dir,
        }
        given += [(option, str(value)) for option, value in others.items() if value is not None]
        if self.bridge is not None:
            given += [("--role", BRIDGE), *_bridge_options(self.bridge)]
        if self.companion:
            given.append(("--role", COMPANION))
        return [word for pair in given for word in pair]


def _bridge_options(bridge: Bridge) -> list[tuple[str, str]]:
    given = [("--autopilot", bridge.mavlink)]
    others = {"--world": bridge.world, "--sensors": bridge.sensors, "--sensor-link": bridge.sensor_link}
    given += [(option, value) for option, value in others.items() if value is not None]
    given.append(("--outputs", ",".join(map(str, bridge.outputs))))
    return [*given, ("--trim", f"{bridge.trim_us:g}"), ("--span", f"{bridge.span_us:g}")]


def options_of(profile: RunProfile, run_directory: Path | None, bridge: Bridge | None = None) -> AgentOptions:
    """What the profile asks for. `run_directory` is where a log belongs, None keeps none."""
    autopilot = profile.autopilot
    if bridge is not None:
        return AgentOptions(link_key_file=autopilot.link_key_file, bridge=bridge)
    addresses = ground_stations_of(profile)
    if autopilot.ground_stations is None:
        addresses = tuple(url for url in addresses if is_free(url))
    return AgentOptions(
        ground_stations=addresses,
        controller=autopilot.controller,
        signing_key_file=autopilot.signing_key_file,
        link_key_file=autopilot.link_key_file,
        log_dir=run_directory.absolute() if run_directory is not None and profile.recording.dataflash else None,
    )


def missing_addresses(profile: RunProfile, options: AgentOptions) -> Sequence[str]:
    """The usual addresses that another program holds: nobody asked for them, so the run goes on without."""
    if options.bridge is not None:
        return []
    return [url for url in ground_stations_of(profile) if url not in options.ground_stations]


def is_free(url: str) -> bool:
    """Whether a listener could be opened there; always for what is sent to."""
    parts = urlsplit(url)
    if parts.scheme != "tcp":
        return True
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((parts.hostname, parts.port))
        except OSError:
            return False
    return True
