"""Options of an agent: from the command line, a file, or the program that contains it."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, Callable, NoReturn

import agent
from agent.files import read_text
from agent.machine import REAL, VIRTUAL
from agent.timing.realtime import DEFAULT_PRIORITY

DEFAULT_LINK = "udp://127.0.0.1:14660"
FCU, COMPANION, BRIDGE = "fcu", "companion", "bridge"
KEEP, REBOOT = "keep", "reboot"
SECTION = "agent"
_BESIDE = {
    "xitl agent": "To install it on a board: xitl agent package, xitl agent deploy. To check a machine: xitl doctor.",
    "xitl-agent.pyz": "To check whether this machine can run it: xitl-agent.pyz doctor.",
}

HIGHEST_SYSTEM_ID = 250  # ground stations and tools use higher numbers

WAITS_AT = "waits at"
"""Part of the first line that an agent prints. Its address ends the line."""


class OptionsError(ValueError):
    """Raised for an invalid option. The message names the option, the cause and the remedy."""


@dataclass(frozen=True)
class Options:
    """Options of the agent. Files are read when the agent is assembled."""

    link: str = DEFAULT_LINK
    """URL at which to wait for the host."""
    role: str = FCU
    system_id: int = 1
    """MAVLink system of the vessel, in any role."""
    ground: tuple[str, ...] = ()
    """Addresses of ground stations."""
    controller: str = ""
    parameters: Path | None = None
    storage: Path | None = None
    log_dir: Path | None = None
    """Directory for a new DataFlash log of each run."""
    log_file: Path | None = None
    """File that every run overwrites."""
    signing_key: Path | None = None
    """Key for ground stations."""
    link_key: Path | None = None
    """Key for the host."""
    realtime: int = 0
    """Priority of SCHED_FIFO, 0 without."""
    cpus: tuple[int, ...] = ()
    """Processors to use, empty for any."""
    kind: str = ""
    """`real`, `virtual`, or empty to detect."""
    machine: str = ""
    """Name of the machine, empty to detect."""
    silence_s: float = 60.0
    """A host that is silent for this time is gone, 0 never."""
    attached: bool = False
    """Whether it ends with the program that started it."""
    autopilot: str = ""
    """Bridge: URL of the other autopilot's MAVLink."""
    world: str = ""
    """Bridge: address that serves the simulator interface (the JSON backend), which sets the autopilot's time."""
    sensors: str = ""
    """Bridge: injection of the sensors."""
    sensor_link: str = ""
    """Bridge: separate link of the sensors, if the injection needs one."""
    outputs: tuple[int, ...] = (1, 3)
    """Bridge: channels that drive the motors, in the order of the motors, from 1."""
    trim_us: float = 1500.0
    """Bridge: pulse width for neutral."""
    span_us: float = 400.0
    """Bridge: pulse width from neutral to full."""
    after_run: str = KEEP
    """Bridge: `keep` or `reboot` the autopilot after a run."""
    fleet: bool = False
    """Bridge: other vessels of a fleet may be heard on the autopilot's line."""


def parse(arguments: list[str] | None, program: str) -> Options:
    """Parse a command line and the file that it names. The command line has priority. Raises OptionsError.

    `--help` and `--version` print and raise SystemExit.
    """
    parser = _parser(program)
    values = vars(parser.parse_args(arguments))
    config = values.pop("config", None)
    if config is not None:
        values = {**_config_values(config, parser), **values}
    for name in ("ground", "cpus", "outputs"):
        if name in values:
            values[name] = tuple(values[name])
    return Options(**values)


def check_bridge(options: Options) -> None:
    """Check the options of a bridge. Raises OptionsError for missing, contradictory or unrelated ones."""
    if options.role != BRIDGE:
        for name in ("autopilot", "world", "sensors", "sensor_link"):
            if getattr(options, name):
                raise OptionsError(
                    f"{name.replace('_', '-')}: the role {options.role} does not use it; use --role {BRIDGE}"
                )
        if options.after_run != KEEP:
            raise OptionsError(f"after-run: the role {options.role} has no autopilot to reboot; use --role {BRIDGE}")
        return
    from agent.bridges.kinds import NEEDED_LINK, NO_LINK, BridgeError, bridge_kind

    if not options.autopilot:
        raise OptionsError(
            "autopilot: a bridge needs the URL of its MAVLink; write it like --autopilot tcp://127.0.0.1:5760"
        )
    if not options.world and not options.sensors:
        raise OptionsError("sensors, world: the autopilot would get no data; give --sensors, --world or both")
    if options.world and not options.world.startswith("udp://"):
        raise OptionsError(f"world: {options.world} is not a UDP address; write it like udp://127.0.0.1:9002")
    try:
        kind = bridge_kind(options.sensors) if options.sensors else None
    except BridgeError as error:
        raise OptionsError(f"sensors: {error}") from None
    if options.world and kind is not None and kind.sets_time:
        raise OptionsError(f"world: {options.sensors} sets the time of the autopilot itself; leave it out")
    if kind is not None and kind.sensor_link == NEEDED_LINK and not options.sensor_link:
        raise OptionsError(
            f"sensor-link: {options.sensors} needs a separate line; write it like --sensor-link serial:///dev/ttyUSB0"
        )
    if options.sensor_link and (kind is None or kind.sensor_link == NO_LINK):
        who = f"the sensors {options.sensors} use" if options.sensors else "the world uses"
        raise OptionsError(f"sensor-link: {who} none; leave it out")


def read_option_file(path: Path) -> str:
    """Return the text of a file that an option names. Raises OptionsError."""
    try:
        return read_text(path)
    except UnicodeDecodeError:
        raise OptionsError(f"{path}: cannot be read (not text); check the path") from None
    except OSError as error:
        raise OptionsError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def _config_values(path: Path, parser: argparse.ArgumentParser) -> dict[str, Any]:
    """Return the values by field. The keys of the file are the long options. Paths are relative to the file."""
    from configparser import ConfigParser
    from configparser import Error as ConfigError

    known = {
        option[2:]: action
        for action in parser._actions
        for option in action.option_strings
        if option.startswith("--") and action.dest not in ("help", "version", "config", "attached", "fleet")
    }
    config = ConfigParser(interpolation=None, default_section="")
    try:
        config.read_string(read_option_file(path), str(path))
    except ConfigError as error:
        raise OptionsError(f"{path}: {' '.join(str(error).split())}; write KEY = VALUE under [{SECTION}]") from None
    for section in config.sections():
        if section != SECTION:
            raise OptionsError(f"{path}: unknown section [{section}]; write all under [{SECTION}]")
    if not config.has_section(SECTION):
        raise OptionsError(f"{path}: has no section [{SECTION}]; write it above the options")
    values: dict[str, Any] = {}
    for key, text in config.items(SECTION):
        if key not in known:
            raise OptionsError(f"{path}: unknown key {key}; use one of {', '.join(sorted(known))}")
        values[known[key].dest] = _config_value(path, key, text.strip(), known[key])
    return values


def _config_value(path: Path, key: str, text: str, action: argparse.Action) -> Any:
    kind: Any = action.type or str
    if isinstance(action, argparse._AppendAction):
        return [kind(word) for word in text.split()]
    if not text and action.nargs == "?":
        return action.const
    try:
        value = kind(text)
    except (argparse.ArgumentTypeError, ValueError) as error:
        raise OptionsError(f"{path}: {key} = {text}: {error}") from None
    if action.choices is not None and value not in action.choices:
        raise OptionsError(f"{path}: {key} = {text}; use one of {', '.join(action.choices)}")
    return path.parent / value if isinstance(value, Path) else value


class _Parser(argparse.ArgumentParser):
    """Parser that refuses with one sentence."""

    def error(self, message: str) -> NoReturn:
        raise OptionsError(f"{message}; see {self.prog} --help")


def _whole_number(what: str, most: int) -> Callable[[str], int]:
    """Return the converter of an option that is `what`, from 1 to `most`."""

    def convert(text: str) -> int:
        if not (text.isdigit() and 1 <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"{text} is not {what}; use 1 to {most}")
        return int(text)

    return convert


def _number(what: str, advice: str, is_valid: Callable[[float], bool]) -> Callable[[str], float]:
    """Return the converter of an option that is `what`."""

    def convert(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = nan
        if not is_valid(number):
            raise argparse.ArgumentTypeError(f"{text} is not {what}; {advice}")
        return number

    return convert


def _cpus(text: str) -> tuple[int, ...]:
    words = text.replace(",", " ").split()
    if not words or not all(word.isdigit() and int(word) < 4096 for word in words):
        raise argparse.ArgumentTypeError(f"{text or 'nothing'} names no processors; write them like 1 or 2,3")
    return tuple(sorted({int(word) for word in words}))


def _channels(text: str) -> tuple[int, ...]:
    words = text.replace(",", " ").split()
    if not 1 <= len(words) <= 8 or not all(word.isdigit() and 1 <= int(word) <= 32 for word in words):
        raise argparse.ArgumentTypeError(f"{text or 'nothing'} names no output channels; write them like 1,3 (1 to 32)")
    return tuple(map(int, words))


def _parser(program: str) -> argparse.ArgumentParser:
    from agent.bridges.kinds import OWN_SENSORS

    parser = _Parser(
        prog=program,
        description="Run the embedded autopilot, a companion or a bridge to another autopilot for a simulation host.",
        epilog=_BESIDE.get(program),
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
    )
    system_id = _whole_number("a MAVLink system of a vessel", HIGHEST_SYSTEM_ID)
    priority = _whole_number("a priority of SCHED_FIFO", 99)
    pulse_us = _number("a pulse width", "use microseconds, like 1500", lambda number: 0.0 < number <= 3000.0)
    seconds = _number("a duration", "use seconds, 0 for no limit", lambda number: 0.0 <= number < 1e6)
    add = parser.add_argument
    add("--link", metavar="URL", help=f"where to wait for the host (default: {DEFAULT_LINK})")
    add("--role", choices=(FCU, COMPANION, BRIDGE), help=f"role of this node (default: {FCU})")
    add(
        "--system-id",
        type=system_id,
        metavar="N",
        help=f"MAVLink system of the vessel, 1 to {HIGHEST_SYSTEM_ID} (default: {Options.system_id})",
    )
    add(
        "--gcs",
        dest="ground",
        action="append",
        metavar="URL",
        help="ground station, repeatable: send to udp://host:port, or listen at tcp://address:port for any number",
    )
    add("--parameters", type=Path, metavar="FILE", help="file of the initial parameters (.parm)")
    add(
        "--storage",
        type=Path,
        metavar="FILE",
        help="file for the parameters, mission and fence that ground stations set",
    )
    add("--log-dir", type=Path, metavar="DIR", help="write a DataFlash log of each run here")
    add("--log-file", type=Path, metavar="FILE", help="write the DataFlash log of each run over this file")
    keys = "64 hexadecimal digits, or a passphrase"
    add("--signing-key", type=Path, metavar="FILE", help=f"MAVLink 2 signing with ground stations: {keys}")
    add("--link-key", type=Path, metavar="FILE", help=f"MAVLink 2 signing with the host, both ways: {keys}")
    add("--controller", metavar="MODULE:CLASS", help="replaces the built-in controller, see docs/controller.md")
    add(
        "--realtime",
        type=priority,
        nargs="?",
        const=DEFAULT_PRIORITY,
        metavar="PRIORITY",
        help=f"schedule by SCHED_FIFO (default priority: {DEFAULT_PRIORITY}) and lock memory, where permitted",
    )
    add("--cpu", dest="cpus", type=_cpus, metavar="N[,N]", help="run only on these processors")
    add(
        "--kind",
        choices=(REAL, VIRTUAL),
        help="whether this machine is a real board or a virtual one (default: detect)",
    )
    add("--machine", metavar="NAME", help="name of this machine (default: its model)")
    add(
        "--silence",
        dest="silence_s",
        type=seconds,
        metavar="SECONDS",
        help=f"end a run in real time when the host is silent for this time (default: {Options.silence_s:g}; 0: never)",
    )
    add("--autopilot", metavar="URL", help="bridge: MAVLink of the other autopilot, like tcp://127.0.0.1:5760")
    add(
        "--world",
        metavar="URL",
        help="bridge: address that serves the JSON simulator interface, like udp://127.0.0.1:9002",
    )
    own = ", ".join(OWN_SENSORS)
    add("--sensors", metavar="NAME", help=f"bridge that injects our sensors: {own}, or a bridge of a package")
    add("--sensor-link", metavar="URL", help="bridge: separate line for the sensors, if the injection needs one")
    add(
        "--outputs",
        type=_channels,
        metavar="N[,N]",
        help="bridge: output channels of the motors, in the order of the motors",
    )
    add("--trim", dest="trim_us", type=pulse_us, metavar="US", help="bridge: pulse width for neutral")
    add("--span", dest="span_us", type=pulse_us, metavar="US", help="bridge: pulse width from neutral to full")
    add(
        "--after-run",
        choices=(KEEP, REBOOT),
        help=f"bridge: reboot the autopilot after each run, or keep it running (default: {KEEP})",
    )
    add("--fleet", action="store_true", help="bridge: other vessels of a fleet may be heard on the autopilot's line")
    add("--attached", action="store_true", help="end with the program that started this one, even when it is killed")
    add("--config", type=Path, metavar="FILE", help=f"file with the same options, as KEY = VALUE under [{SECTION}]")
    add("--version", action="version", version=f"xitl agent {agent.__version__}")
    return parser
