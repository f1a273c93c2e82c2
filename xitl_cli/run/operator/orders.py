"""Orders to a vessel's autopilot, given over its link as a ground station gives them; and faults of that link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from agent.mavlink.modes import PX4_MODES, ROVER_MODE_NUMBERS, shown_mode
from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.profile.checks.faults import check as check_faults
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import Profile, RunProfile
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.run.nodes.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run.nodes.drivers import why_not_armed
from xitl_cli.run.nodes.fault_injection import FaultInjection
from xitl_cli.run.operator.actions import ActionError, Arm, ChangeMode, GoTo, ImpairLink, SwitchFault

GIVE_UP_S = 10.0
SHIPPED = "faults/"
Say = Callable[[str], object]


@dataclass(slots=True)
class _Order:
    """What has been asked of the autopilot and is not done yet. words: for the log."""

    words: str
    since_ns: int | None = None


class VesselOrders:
    """Of one vessel that has an autopilot; `commands` are the operator's own, on the link that the driver uses too.

    An order is repeated every second until the autopilot has accepted it, refuses it, or 10 s have passed, which is
    said. A place is repeated while the vessel is in GUIDED, since ArduPilot does not answer it.
    """

    def __init__(
        self, profile: RunProfile, commands: AutopilotCommands, frame: LocalFrame, faults: FaultInjection
    ) -> None:
        self._profile = profile
        self._commands = commands
        self._frame = frame
        self._injection = faults
        self._faults = dict(profile.faults)
        self._armed: bool | None = None
        self._mode: str | None = None
        self._place: tuple[float, float, float] | None = None
        self._order: _Order | None = None
        self._told_ns: int | None = None

    # What is asked for: `check` raises ActionError, `give` carries out

    def check(self, order: Arm | ChangeMode | GoTo) -> None:
        """Raises ActionError for a mode that the autopilot does not have, or while there is nobody to obey."""
        view = self._commands.view
        if not view.heard:
            raise ActionError("the autopilot has not been heard yet; wait for its heartbeat")
        if isinstance(order, ChangeMode):
            known = PX4_MODES if view.px4 else ROVER_MODE_NUMBERS
            if order.mode not in known:
                raise ActionError(f"mode = {order.mode!r} is none of this autopilot; use {', '.join(known)}")

    def give(self, order: Arm | ChangeMode | GoTo) -> None:
        """In place of what was asked for before."""
        self._commands.forget()
        self._armed, self._mode, self._place, self._told_ns = None, None, None, None
        if isinstance(order, Arm):
            self._armed = order.armed
            self._order = _Order("arm" if order.armed else "disarm")
        elif isinstance(order, ChangeMode):
            self._mode = order.mode
            self._order = _Order(f"mode {order.mode}")
        else:
            lat, lon, alt = self._frame.geodetic(np.array([[order.north_m, order.east_m, 0.0]]))
            self._mode = "GUIDED"
            self._place = float(lat[0]), float(lon[0]), float(alt[0])
            self._order = _Order(f"go to {order.north_m:.1f} N {order.east_m:.1f} E")

    def update(self, now_ns: int, say: Say) -> None:
        """Repeat what is due. To be called at every exchange."""
        commands = self._commands
        if self._order is not None:
            order = self._order
            if order.since_ns is None:
                order.since_ns = now_ns
            if self._obeyed(now_ns):
                say(f"{order.words}: accepted")
                self._order = None
            elif (why := self._refusal(now_ns - order.since_ns)) is not None:
                say(f"{order.words}: {why}{why_not_armed(commands.view.texts, commands.view.unhealthy)}")
                self._order = self._place = None
        if self._order is None and self._place is not None:
            self._repeat_place(now_ns)

    def _obeyed(self, now_ns: int) -> bool:
        commands = self._commands
        if self._armed is not None:
            return commands.arm(now_ns, self._armed)
        if self._place is not None and commands.view.px4:  # the place brings its mode
            commands.go_to(now_ns, *self._place)
            return commands.accepted(dialect.MAV_CMD_DO_REPOSITION)
        assert self._mode is not None
        return commands.set_mode(now_ns, self._mode)

    def _refusal(self, waited_ns: int) -> str | None:
        wanted = dialect.MAV_CMD_COMPONENT_ARM_DISARM if self._armed is not None else dialect.MAV_CMD_DO_SET_MODE
        result = self._commands.view.acks.get(wanted)
        if result in (dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_FAILED, dialect.MAV_RESULT_UNSUPPORTED):
            return "refused by the autopilot"
        return f"not accepted within {GIVE_UP_S:g} s" if waited_ns > GIVE_UP_S * 1e9 else None

    def _repeat_place(self, now_ns: int) -> None:
        """Until somebody asks for another mode."""
        assert self._place is not None
        commands = self._commands
        if self._told_ns is not None and now_ns - self._told_ns < REPEAT_S * 1e9:
            return
        if self._told_ns is not None and commands.view.mode != shown_mode("GUIDED", commands.view.px4):
            self._place = None
            return
        self._told_ns = now_ns
        commands.go_to(now_ns, *self._place)

    # Faults of its sensors, its agents and their links

    def read_fault(self, action: SwitchFault, now_ns: int) -> FaultSpec:
        """What is to be injected, with its times. Raises ActionError."""
        fault = self._faults.get(action.name)
        if fault is None:
            fault = self._shipped(action.name)
        in_force = action.name in self._injection.schedule.names_in_force()
        if action.on == in_force:
            raise ActionError(f"fault: {action.name} is {'in force' if in_force else 'not in force'} already")
        return self._timed(action.name, fault, action.on, now_ns)

    def read_link(self, action: ImpairLink, now_ns: int) -> FaultSpec:
        """The same of a link. Raises ActionError."""
        name, link = link_fault_name(action), action.fault()
        if link is not None:
            return self._timed(name, FaultSpec(link=link), True, now_ns)
        if name not in self._injection.schedule.names_in_force():
            raise ActionError(f"link: that to {action.link} is good already; give it loss, delay_s or cut")
        return self._timed(name, self._faults[name], False, now_ns)

    def inject(self, name: str, fault: FaultSpec) -> None:
        """From now on."""
        self._faults[name] = fault
        self._injection.set(name, fault)

    def fault_names(self) -> tuple[str, ...]:
        """Those that may be switched on by name, the profile's first."""
        own = [name for name in self._faults if not name.startswith(_LINK)]
        return tuple(dict.fromkeys([*own, *_shipped_names()]))

    def _timed(self, name: str, fault: FaultSpec, on: bool, now_ns: int) -> FaultSpec:
        now_s = now_ns / 1e9
        if not on:
            return replace(fault, until_s=now_s)
        fault = replace(fault, from_s=now_s, until_s=None)
        tried = cast(Profile, replace(self._profile, faults={name: fault}))
        for _, sentence in check_faults(tried):
            raise ActionError(sentence)
        return fault

    def _shipped(self, name: str) -> FaultSpec:
        known = self.fault_names()
        if name not in known:
            raise ActionError(
                f"fault: {name!r} is neither one of the profile nor a shipped one; use {', '.join(known)}"
            )
        try:
            faults = load_profile(f"{SHIPPED}{name}").faults or {}
        except UserError as error:
            raise ActionError(str(error)) from None
        return next(iter(faults.values()))


_LINK = "link to "


def link_fault_name(action: ImpairLink) -> str:
    """What the fault that an operator puts on a link is called."""
    return f"{_LINK}{action.link}"


def _shipped_names() -> list[str]:
    return sorted(name.removeprefix(SHIPPED) for name in shipped_profiles() if name.startswith(SHIPPED))
