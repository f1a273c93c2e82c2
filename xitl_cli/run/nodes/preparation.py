"""Preparation of another autopilot before it is commanded: hear it, set its parameters, upload the mission."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from agent.mavlink.commands import CommandClient
from agent.mavlink.exchange import Request, Target, Timer
from agent.mavlink.missions import MISSION, MissionUpload, result_name
from agent.mavlink.parameters import ParameterClient
from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.setup import PLAN_KEYS, Plans, Send
from xitl_cli.run.nodes.drivers import VehicleDriver

SHORTEST_HEARTBEAT_S = 20.0
ANSWER_S = 1.0
TRIES = 5
MISSION_S = 20.0
REFUSED_S = 10.0  # an autopilot that has just been started has no room for a mission yet
PREFLIGHT_CALIBRATION = 241  # MAV_CMD_PREFLIGHT_CALIBRATION
ACCEPT_AS_IS = 76.0  # its parameter 5, as ArduPilot reads it
NOT_TAKEN = "the link may lose too much: check the cable, and autopilot.bridge.mavlink"
WALL_SHARE = 0.25
"""Of the seconds of simulation time, so many have to have passed on the wall too: see PatientTimer."""


class PatientTimer(Timer):
    """Over when simulation time and the wall say so; in real time that is the one of the simulation.

    In lockstep simulation time runs many times faster than a line and a process can.
    """

    def __init__(self) -> None:
        super().__init__()
        self._wall_s = 0.0

    def start(self, now_ns: int) -> None:
        super().start(now_ns)
        self._wall_s = time.monotonic()

    def is_over(self, now_ns: int, seconds: float) -> bool:
        return super().is_over(now_ns, seconds) and time.monotonic() - self._wall_s >= seconds * WALL_SHARE


class ParameterStep:
    """Sets what differs, one after the other, and sees that it took.

    `update` is called at every exchange, `handle` for every message. Raises UserError from `update` when the autopilot
    does not know a parameter or keeps another value. changed: names of what was set.
    """

    def __init__(self, send: Send, target: Target, values: Mapping[str, float], px4: bool = False) -> None:
        self.changed: list[str] = []
        self._send = send
        self._client = ParameterClient(target, px4, tries=TRIES, answer_s=ANSWER_S, new_timer=PatientTimer)
        self._left = list(values.items())
        self._request: Request | None = None
        self._set = False
        self._refusal: str | None = None

    @property
    def done(self) -> bool:
        """Whether all are as they should be."""
        return not self._left

    def update(self, sim_ns: int) -> None:
        """Ask what is due."""
        if self._refusal is not None:
            raise UserError(self._refusal)
        if not self._left:
            return
        name, value = self._left[0]
        if self._request is None:
            try:
                self._request = self._client.set(name, value) if self._set else self._client.read(name)
            except ValueError as error:
                raise UserError(f"autopilot.parameters.{name}: {error}") from None
        for message in self._request.poll(sim_ns):
            self._send(message)
        if self._request.done:
            raise UserError(
                f"autopilot.parameters.{name}: the autopilot did not answer {TRIES} times; its firmware may not have "
                f"it (see `xitl params check`), or {NOT_TAKEN}"
            )

    def handle(self, message: Any) -> None:
        """A message of the autopilot."""
        if self._request is None:
            return
        self._request.handle(message, 0)
        if self._request.answer is None:
            return
        name, value = self._left[0]
        kept = self._client.value(self._request.answer)
        self._request = None
        if math.isclose(kept, value, rel_tol=1e-5, abs_tol=1e-7):
            if self._set:
                self.changed.append(name)
            self._left.pop(0)
            self._set = False
        elif self._set:
            self._refusal = (
                f"autopilot.parameters.{name} = {value:g}: the autopilot keeps {kept:g}; use a value that it takes"
            )
        else:
            self._set = True


class MissionStep:
    """Uploads plans one after the other; item 0 of a mission is home. `update` and `handle` as above.

    Raises UserError from `update` when the autopilot refuses one or does not finish taking it.
    """

    def __init__(self, send: Send, target: Target, plans: Plans) -> None:
        self._send = send
        self._target = target
        self._left = [
            (
                mission_type,
                MissionUpload(
                    target,
                    items,
                    mission_type,
                    repeat_s=ANSWER_S,
                    give_up_s=MISSION_S,
                    refused_s=REFUSED_S,
                    new_timer=PatientTimer,
                ),
            )
            for mission_type, items in plans.items()
        ]
        self._now_ns = 0

    @property
    def done(self) -> bool:
        """Whether all are on board."""
        return not self._left

    def update(self, sim_ns: int) -> None:
        """Announce it, and again while nobody asks for it."""
        self._now_ns = sim_ns
        if not self._left:
            return
        mission_type, upload = self._left[0]
        for message in upload.poll(sim_ns):
            self._send(message)
        if not upload.done:
            return
        key = PLAN_KEYS[mission_type]
        if upload.result is None:
            raise UserError(f"{key}: the autopilot did not finish taking it in {MISSION_S:.0f} s; {NOT_TAKEN}")
        raise UserError(f"{key}: the autopilot refused it ({result_name(upload.result)})")

    def handle(self, message: Any) -> None:
        """A message of the autopilot."""
        if not self._left:
            return
        mission_type, upload = self._left[0]
        for reply in upload.handle(message, self._now_ns):
            self._send(reply)
        if upload.accepted:
            self._left.pop(0)
            if mission_type == MISSION:  # it may be from a run before
                self._send(dialect.MAVLink_mission_set_current_message(*self._target, 1))


class CalibrationStep:
    """Has the accelerometer offsets in the parameters accepted as a calibration; `update` and `handle` as above.

    An autopilot whose storage is empty, started here or on a board, takes no accelerometer for calibrated, whatever the
    parameters say. A SITL build does. Refused or not known, it is left at that: the pre-arm checks then say what is
    missing.
    """

    def __init__(self, send: Send, target: Target, wanted: bool) -> None:
        self._send = send
        client = CommandClient(target, TRIES, ANSWER_S, PatientTimer)
        self._request = client.command(PREFLIGHT_CALIBRATION, 0.0, 0.0, 0.0, 0.0, ACCEPT_AS_IS)
        self._wanted = wanted

    @property
    def done(self) -> bool:
        """Whether it was answered, or not in the end."""
        return not self._wanted or self._request.done

    def update(self, sim_ns: int) -> None:
        """Ask, and again while nobody answers."""
        if self._wanted:
            for message in self._request.poll(sim_ns):
                self._send(message)

    def handle(self, message: Any) -> None:
        """A message of the autopilot."""
        self._request.handle(message, 0)


class Preparation(VehicleDriver):
    """A driver that goes before another one: all on simulation time, repeated where something was lost.

    With `held` the vessel's state is frozen until the autopilot has armed for the first time. `where` is its address,
    for people; it is given up when nothing of it was heard for `heartbeat_s` from the start, or when it is still
    starting after `arm_timeout_s`, when a driver would give up too. `complained` ends the sentence, as it does when a
    step or the other driver gives up.
    """

    def __init__(
        self,
        driver: VehicleDriver,
        view: AgentView,
        parameters: ParameterStep,
        mission: MissionStep,
        calibration: CalibrationStep,
        held: bool,
        where: str,
        heartbeat_s: float,
        arm_timeout_s: float,
        complained: Callable[[], str] = lambda: "",
    ) -> None:
        self._driver = driver
        self._view = view
        self._parameters = parameters
        self._mission = mission
        self._calibration = calibration
        self._held = held
        self._where = where
        self._complained = complained
        self._heartbeat_s = max(heartbeat_s, SHORTEST_HEARTBEAT_S)
        self._arm_timeout_s = arm_timeout_s
        self._started = False

    def begin(self, context: RunContext) -> None:
        self._driver.begin(context)

    @property
    def departed(self) -> bool:
        return self._driver.departed

    def finish(self) -> None:
        self._driver.finish()

    def report(self) -> dict[str, Any]:
        return self._driver.report()

    def update(self, sim_ns: int) -> None:
        if self._held and self._view.armed:
            self._held = False
        try:
            self._update_step(sim_ns)
        except UserError as error:
            raise UserError(f"{error}{self._complained()}") from error

    def _update_step(self, sim_ns: int) -> None:
        view = self._view
        if not view.heard:
            if sim_ns > self._heartbeat_s * 1e9:
                raise UserError(
                    f"{self._where}: no heartbeat of the autopilot came in {self._heartbeat_s:.0f} s; check that it "
                    "runs, that this is its MAVLink port, and autopilot.bridge.mavlink"
                )
            return
        if not self._parameters.done:
            self._parameters.update(sim_ns)
            return
        if view.starting and not self._started:
            if sim_ns > self._arm_timeout_s * 1e9:
                said = "; ".join(dict.fromkeys(list(view.texts)[-2:])) or "nothing"
                raise UserError(
                    f"{self._where}: the autopilot is still starting after {self._arm_timeout_s:g} s and said: {said}; "
                    "mend that and start it anew, or give it longer by autopilot.arm_timeout_s"
                )
            return
        self._started = True
        for step in (self._mission, self._calibration):
            if not step.done:
                step.update(sim_ns)
                return
        self._driver.update(sim_ns)

    def handle(self, message: Any) -> None:
        self._parameters.handle(message)
        self._mission.handle(message)
        self._calibration.handle(message)
        self._driver.handle(message)

    @property
    def ready(self) -> bool:
        prepared = self._parameters.done and self._mission.done and self._calibration.done
        return self._view.heard and prepared and self._driver.ready

    def progress(self) -> Progress:
        progress = self._driver.progress()
        if not self._held or progress.waits_for:
            return progress
        return replace(progress, waits_for=self._waits_for())

    def _waits_for(self) -> str:
        if not self._view.heard:
            return "the autopilot to be heard"
        if not self._parameters.done:
            return "the autopilot to take its parameters"
        if not self._started:
            return "the autopilot to start"
        if not self._mission.done:
            return "the autopilot to take the mission"
        return "the autopilot to arm" if self._view.ready_to_arm else "the autopilot to become ready to arm"
