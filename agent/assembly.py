"""Assemble a node from its options. All parts of an agent are connected here."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Callable

from agent.faults import AgentFaults
from agent.fcu.control.controller import ControllerError
from agent.machine import read_machine
from agent.mavlink.parameter_rows import ParameterError
from agent.node import AgentNode
from agent.options import BRIDGE, COMPANION, REBOOT, Options, OptionsError, check_bridge, read_option_file
from agent.reports import Identity
from agent.roles.role import Role
from agent.roles.storage import StorageError
from agent.timing.clock import MonotonicClock
from agent.wire.codec import Message
from agent.wire.link import Link
from agent.wire.signing import Signing, SigningKeyError, read_key_file
from agent.wire.transport import Transport, TransportError

if TYPE_CHECKING:
    from agent.bridges.injector import Injector
    from agent.fcu.dataflash.flight_log import FlightLog

AUTOPILOT_COMPONENT_ID, COMPANION_COMPONENT_ID = 1, 191  # MAV_COMP_ID_AUTOPILOT1, MAV_COMP_ID_ONBOARD_COMPUTER

REFUSALS = (OptionsError, ParameterError, TransportError, StorageError, SigningKeyError, ControllerError)
"""Exceptions that `assemble` raises. Each message is one sentence."""


def assemble(
    transport: Transport, options: Options, opened: ExitStack, say: Callable[[str], None] = lambda sentence: None
) -> AgentNode:
    """Return the node that the options describe, on an open transport. `say` is the same as for AgentNode.

    The caller closes the transport. `assemble` registers everything else that must be closed in `opened`. Raises
    `REFUSALS`.
    """
    clock = MonotonicClock()
    faults = AgentFaults(clock)
    opened.callback(faults.end)
    key = _signing(options.link_key, "--link-key")
    component_id = COMPANION_COMPONENT_ID if options.role == COMPANION else AUTOPILOT_COMPONENT_ID
    link = Link(faults.wrap(transport), options.system_id, component_id, signing=key)
    check_bridge(options)
    if options.role == COMPANION:
        from agent.companion.role import CompanionRole

        _refuse_what_the_embedded_one_has(options, "a companion")
        role: Role = CompanionRole()
    else:
        role = _bridge(options, link.send, opened) if options.role == BRIDGE else _autopilot(options, link.send, opened)
    machine = read_machine()
    machine = machine._replace(kind=options.kind or machine.kind, name=options.machine or machine.name)
    identity = Identity(role.nodes, machine, signed=key is not None)
    return AgentNode(link, role, identity, faults, options.silence_s, clock, say)


def _refuse_what_the_embedded_one_has(options: Options, who: str) -> None:
    for name in ("ground", "controller", "parameters", "storage", "log_dir", "log_file", "signing_key"):
        if getattr(options, name):
            option = "gcs" if name == "ground" else name.replace("_", "-")
            raise OptionsError(f"{option}: {who} has none; leave it out, or use the role fcu")


def _bridge(options: Options, send: Callable[..., bool], opened: ExitStack) -> Role:
    from agent.bridges.guard import GuardedInjector
    from agent.bridges.injector import InjectorError
    from agent.bridges.kinds import JSON_WORLD, bridge_kind, bridge_kinds, package_of_bridge
    from agent.bridges.role import BridgeRole, MotorOutputs
    from agent.bridges.vehicle_link import VehicleLink

    _refuse_what_the_embedded_one_has(options, "a bridge")
    injectors: list[Injector] = []
    outputs_wanted = not any(kind.returns_outputs for kind in bridge_kinds(options.world, options.sensors))
    vehicle = VehicleLink(options.autopilot, outputs_wanted, options.system_id, options.fleet)
    opened.callback(vehicle.close)
    try:
        if options.world:
            injectors.append(JSON_WORLD.open(options.world, vehicle))
            opened.callback(injectors[-1].close)
        if options.sensors:
            kind, package = bridge_kind(options.sensors), package_of_bridge(options.sensors)
            if package:
                injectors.append(GuardedInjector(kind, options.sensors, package, options.sensor_link, vehicle))
            else:
                injectors.append(kind.open(options.sensor_link, vehicle))
            opened.callback(injectors[-1].close)
    except InjectorError as error:
        raise OptionsError(str(error)) from None
    outputs = MotorOutputs(options.outputs, options.trim_us, options.span_us)
    role = BridgeRole(send, vehicle, injectors, outputs, reboots=options.after_run == REBOOT)
    for injector in injectors:
        if isinstance(injector, GuardedInjector) and injector.problem:
            raise OptionsError(f"sensors: {injector.problem}")
    return role


def _autopilot(options: Options, send: Callable[[Message], bool], opened: ExitStack) -> Role:
    from agent.fcu.control.controller import load_controller
    from agent.fcu.dataflash.stored_logs import StoredLogs
    from agent.fcu.mavlink.channel import MavlinkChannel
    from agent.fcu.parameters import Parameters
    from agent.fcu.vehicle.autopilot import Autopilot
    from agent.roles.autopilot import AutopilotRole
    from agent.roles.ground_stations import GroundStations
    from agent.roles.storage import Storage

    parameters = Parameters(system_id=options.system_id)
    if options.parameters is not None:
        parameters.load(read_option_file(options.parameters), str(options.parameters))
    make_controller = load_controller(options.controller) if options.controller else None
    signing = _signing(options.signing_key, "--signing-key")
    storage = None
    if options.storage is not None:
        storage = Storage(options.storage)
        opened.callback(storage.close)
    ground = None
    if options.ground:
        ground = GroundStations(options.ground, options.system_id, AUTOPILOT_COMPONENT_ID, signing)
        opened.callback(ground.close)

    def channel() -> MavlinkChannel:
        own = Parameters({name: parameters[name] for name in parameters}, options.system_id)
        return MavlinkChannel(Autopilot(own, make_controller), options.system_id, AUTOPILOT_COMPONENT_ID)

    stored = StoredLogs(options.log_dir, options.log_file)
    return AutopilotRole(channel, send, ground, storage, _log_of(options, opened), stored)


def _log_of(options: Options, opened: ExitStack) -> Callable[[Callable[[], int]], FlightLog] | None:
    directory, file = options.log_dir, options.log_file
    if directory is None and file is None:
        return None
    if directory is not None and file is not None:
        raise OptionsError("log-dir, log-file: a log needs only one of them; leave the other out")
    from agent.fcu.dataflash.flight_log import FlightLog
    from agent.fcu.dataflash.writer import fixed_log_opener, numbered_log_opener

    opener = fixed_log_opener(file) if file is not None else numbered_log_opener(directory or Path())

    def make(now_ns: Callable[[], int]) -> FlightLog:
        log = FlightLog(opener, now_ns)
        opened.callback(log.close)
        return log

    return make


def _signing(key_file: Path | None, option: str) -> Signing | None:
    return None if key_file is None else Signing(read_key_file(str(key_file), option))
