"""Orders to a vessel's autopilot over its link, as from a ground station, and faults of that link."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, cast

import numpy as np

from agent.mavlink.missions import MissionUpload, waypoint_items
from agent.mavlink.modes import PX4_MODES, ROVER_MODE_NUMBERS, shown_mode
from agent.wire import dialect
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.profile.checks.faults import check as check_faults
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import Profile, RunProfile
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.run.links.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.fault_injection import FaultInjection
from xitl_cli.run.operator.actions import (
    ActionError,
    Arm,
    ChangeMission,
    ChangeMode,
    CommandMotor,
    EndRun,
    GoTo,
    ImpairLink,
    SteerVelocity,
    SwitchFault,
)
from xitl_cli.run.operator.steering import SILENT_S, Order, Say, Steering, VelocityStream

GIVE_UP_S = 10.0
OWN_END = "the vessel's driver ends the run by itself; this action needs driver.kind: ros"
SHIPPED = "faults/"


@dataclass(slots=True)
class _Order:
    """An order to the autopilot that is not done yet."""

    words: str
    """Text for the log."""
    since_ns: int | None = None


class VesselOrders(Steering):
    """Orders to one vessel with an autopilot. `commands`: the operator's commander, on the same link as the driver's.

    An order is repeated every second until the autopilot accepts it, refuses it, or 10 s have passed. The log reports
    the outcome. A place is repeated while the vessel is in GUIDED, because ArduPilot does not answer it. A velocity is
    a stream, see VelocityStream: when it becomes silent, the vessel goes to HOLD.

    driver: the other commander of the autopilot; streams wait until it has departed. silent_s: time until a stream
    counts as silent.
    """

    def __init__(
        self,
        profile: RunProfile,
        commands: AutopilotCommands,
        frame: LocalFrame,
        faults: FaultInjection,
        driver: VehicleDriver,
        silent_s: float = SILENT_S,
    ) -> None:
        self.silences = 0
        self.asked_by: Counter[str] = Counter()
        self._velocity = VelocityStream(commands, silent_s)
        self._driver = driver
        self._upload: MissionUpload | None = None
        self._profile = profile
        self._commands = commands
        self._frame = frame
        self._injection = faults
        self._faults = dict(profile.faults)
        self._armed: bool | None = None
        self._mode: str | None = None
        self._place: tuple[float, float, float] | None = None
        self._mission: ChangeMission | None = None
        self._cleared = False
        self._order: _Order | None = None
        self._told_ns: int | None = None
        self._now_ns = 0

    # Orders, as in Steering

    def check(self, order: Order) -> None:
        view = self._commands.view
        if isinstance(order, EndRun):
            if self._profile.driver.kind != "ros":
                raise ActionError(f"end: {OWN_END}")
            return
        if isinstance(order, CommandMotor):
            raise ActionError(
                "motor: the autopilot commands the motors; use velocity, or a profile with autopilot.kind: none"
            )
        if isinstance(order, SteerVelocity):
            if self._profile.autopilot.kind == "px4":
                raise ActionError("velocity: PX4 does not accept a speed and a turn rate; use goto")
            return  # a stream waits for the driver to get under way, and so for the first heartbeat
        if not view.heard:
            raise ActionError("the autopilot has not sent a heartbeat yet; wait for it")
        if isinstance(order, ChangeMode):
            known = PX4_MODES if view.px4 else ROVER_MODE_NUMBERS
            if order.mode not in known:
                raise ActionError(f"mode = {order.mode!r} is no mode of this autopilot; use {', '.join(known)}")

    def give(self, order: Order) -> None:
        if isinstance(order, SteerVelocity):
            if not self._velocity.active:
                self._begin(self._order if self._armed is not None else None, self._armed)
            self._velocity.set(order.speed_mps, order.turn_rate_radps)
        elif isinstance(order, Arm):
            self._begin(_Order("arm" if order.armed else "disarm"), order.armed)
        elif isinstance(order, ChangeMode):
            self._velocity.yield_to(order.mode)
            self._begin(_Order(f"mode {order.mode}"))
            self._mode = order.mode
        elif isinstance(order, GoTo):
            self._velocity.stop()
            self._begin(_Order(f"go to {order.north_m:.1f} N {order.east_m:.1f} E"))
            self._mode = "GUIDED"
            self._place = self._geodetic(order.north_m, order.east_m)
        elif isinstance(order, ChangeMission):
            self._begin(_Order(f"{order.do} the mission"))
            self._mission = order
            if order.do == "start":
                self._velocity.yield_to("AUTO")
            elif order.do == "replace":
                first = order.waypoints_ned_m[0]
                places = [self._geodetic(*place) for place in (first, *order.waypoints_ned_m)]
                self._upload = self._commands.upload(waypoint_items(places))
        else:
            self._driver.finish()

    def _begin(self, order: _Order | None, armed: bool | None = None) -> None:
        self._commands.forget()
        self._mode = self._place = self._told_ns = self._mission = self._upload = None
        self._armed, self._order, self._cleared = armed, order, False

    def _geodetic(self, north_m: float, east_m: float) -> tuple[float, float, float]:
        lat, lon, alt = self._frame.geodetic(np.array([[north_m, east_m, 0.0]]))
        return float(lat[0]), float(lon[0]), float(alt[0])

    def handle(self, message: Any) -> None:
        """Handle a message of the autopilot: its answers to a new mission."""
        if self._mission is None or self._order is None:
            return
        if self._upload is not None:
            self._commands.send_all(self._upload.handle(message, self._now_ns))
        elif self._mission.do == "clear" and message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            self._cleared = int(message.type) == dialect.MAV_MISSION_ACCEPTED

    def update(self, now_ns: int, say: Say) -> None:
        """Repeat the order when it is due. Call it at every exchange."""
        commands = self._commands
        self._now_ns = now_ns
        if self._velocity.update(now_ns, say, self._driver.departed and commands.view.heard):
            self.silences += 1
            self.give(ChangeMode(mode="HOLD"))
        if self._order is not None:
            order = self._order
            if order.since_ns is None:
                order.since_ns = now_ns
            if self._repeat_order(now_ns):
                say(f"{order.words}: accepted")
                self._order = None
            else:
                why = self._refusal(now_ns - order.since_ns)
                if why is not None:
                    say(f"{order.words}: {why}{commands.view.why_not_armed()}")
                    self._order = self._place = None
        if self._order is not None or self._place is None:
            return
        # Repeat the place every second until another mode is chosen.
        if self._told_ns is None or now_ns - self._told_ns >= REPEAT_S * 1e9:
            if self._told_ns is not None and commands.view.mode != shown_mode("GUIDED", commands.view.px4):
                self._place = None
                return
            self._told_ns = now_ns
            commands.go_to(now_ns, *self._place)

    def _repeat_order(self, now_ns: int) -> bool:
        """Send the order again when it is due. Returns whether the autopilot has accepted it."""
        commands, mission = self._commands, self._mission
        if self._armed is not None:
            return commands.arm(now_ns, self._armed)
        if mission is not None:
            if mission.do == "start":
                return commands.start_mission(now_ns)
            if self._upload is not None:
                commands.send_all(self._upload.poll(now_ns))
                return self._upload.accepted
            if self._told_ns is None or now_ns - self._told_ns >= REPEAT_S * 1e9:
                self._told_ns = now_ns
                commands.clear_mission()
            return self._cleared
        if self._place is not None and commands.view.px4:  # the place sets its mode
            commands.go_to(now_ns, *self._place)
            return commands.accepted(dialect.MAV_CMD_DO_REPOSITION)
        assert self._mode is not None
        return commands.set_mode(now_ns, self._mode)

    def _refusal(self, waited_ns: int) -> str | None:
        command: int | None = dialect.MAV_CMD_DO_SET_MODE
        if self._armed is not None:
            command = dialect.MAV_CMD_COMPONENT_ARM_DISARM
        elif self._mission is not None:
            command = dialect.MAV_CMD_MISSION_START if self._mission.do == "start" else None
        result = None if command is None else self._commands.view.acks.get(command)
        if result in (dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_FAILED, dialect.MAV_RESULT_UNSUPPORTED):
            return "refused by the autopilot"
        return f"not accepted within {GIVE_UP_S:g} s" if waited_ns > GIVE_UP_S * 1e9 else None

    # Faults of the vessel's sensors, agents and links

    def read_fault(self, action: SwitchFault, now_ns: int) -> FaultSpec:
        """Return the fault to inject, with its times. Raises ActionError."""
        name = action.name
        fault = self._faults.get(name)
        if fault is None:
            known = self.fault_names()
            if name not in known:
                raise ActionError(f"fault: {name!r} is neither in the profile nor shipped; use {', '.join(known)}")
            try:
                shipped = load_profile(f"{SHIPPED}{name}").faults or {}
            except UserError as error:
                raise ActionError(str(error)) from None
            fault = next(iter(shipped.values()))
        active = name in self._injection.schedule.names_in_force()
        if action.on == active:
            raise ActionError(f"fault: {name} is {'active' if active else 'not active'} already")
        return self._timed(name, fault, action.on, now_ns)

    def read_link(self, action: ImpairLink, now_ns: int) -> FaultSpec:
        """Return the link fault to inject, with its times. Raises ActionError."""
        name, link = link_fault_name(action), action.fault()
        if link is not None:
            return self._timed(name, FaultSpec(link=link), True, now_ns)
        if name not in self._injection.schedule.names_in_force():
            raise ActionError(f"link: the link to {action.link} has no fault; give loss, delay_s or cut")
        return self._timed(name, self._faults[name], False, now_ns)

    def inject(self, name: str, fault: FaultSpec) -> None:
        """Inject the fault from now on."""
        self._faults[name] = fault
        self._injection.set(name, fault)

    def fault_names(self) -> tuple[str, ...]:
        """Return the faults that an action can switch on by name, the profile's first."""
        own = [name for name in self._faults if not name.startswith(_LINK)]
        shipped = sorted(name.removeprefix(SHIPPED) for name in shipped_profiles() if name.startswith(SHIPPED))
        return tuple(dict.fromkeys([*own, *shipped]))

    def _timed(self, name: str, fault: FaultSpec, on: bool, now_ns: int) -> FaultSpec:
        now_s = now_ns / 1e9
        if not on:
            return replace(fault, until_s=now_s)
        fault = replace(fault, from_s=now_s, until_s=None)
        tried = cast(Profile, replace(self._profile, faults={name: fault}))
        for _, sentence in check_faults(tried):
            raise ActionError(sentence)
        return fault


_LINK = "link to "


def link_fault_name(action: ImpairLink) -> str:
    """Return the name of the fault that an operator puts on a link."""
    return f"{_LINK}{action.link}"
