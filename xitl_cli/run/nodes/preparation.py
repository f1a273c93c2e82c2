"""Preparation of another autopilot: wait for its heartbeat, set its parameters, upload the mission."""

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
REFUSED_S = 10.0  # an autopilot that was just started has no space for a mission yet
PREFLIGHT_CALIBRATION = 241  # MAV_CMD_PREFLIGHT_CALIBRATION
ACCEPT_AS_IS = 76.0  # its parameter 5, as ArduPilot reads it
NOT_TAKEN = "the link may lose too much: check the cable, and autopilot.bridge.mavlink"
WALL_SHARE = 0.25
"""Share of the simulation time that must also have passed on the wall clock: see PatientTimer."""


class PatientTimer(Timer):
    """A timer that ends when both simulation time and the wall clock allow it. In real time, simulation time decides.

    In lockstep, simulation time runs many times faster than a line and a process can.
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
    """Sets the parameters that differ, one after the other, and checks them.

    Call `update` at every exchange and `handle` for every message. `update` raises UserError when the autopilot does
    not know a parameter or keeps another value. changed: names of the parameters that were set.
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
        """Whether all parameters have their values."""
        return not self._left

    def update(self, sim_ns: int) -> None:
        """Send the request that is due."""
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
        """Handle a message of the autopilot."""
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
    """Uploads plans one after the other; item 0 of a mission is home. `update` and `handle` as in ParameterStep.

    `update` raises UserError when the autopilot refuses a plan or does not finish its upload.
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
        """Whether all plans are uploaded."""
        return not self._left

    def update(self, sim_ns: int) -> None:
        """Announce the plan, and repeat that until the autopilot requests it."""
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
        """Handle a message of the autopilot."""
        if not self._left:
            return
        mission_type, upload = self._left[0]
        for reply in upload.handle(message, self._now_ns):
            self._send(reply)
        if upload.accepted:
            self._left.pop(0)
            if mission_type == MISSION:  # the current item may be from an earlier run
                self._send(dialect.MAVLink_mission_set_current_message(*self._target, 1))


class CalibrationStep:
    """Accepts the accelerometer offsets of the parameters as a calibration; `update` and `handle` as in ParameterStep.

    An autopilot with empty storage, on this machine or on a board, treats no accelerometer as calibrated, whatever its
    parameters. A SITL build does. If the command is refused or unknown, the step ends. The pre-arm checks then report
    the missing calibration.
    """

    def __init__(self, send: Send, target: Target, wanted: bool) -> None:
        self._send = send
        client = CommandClient(target, TRIES, ANSWER_S, PatientTimer)
        self._request = client.command(PREFLIGHT_CALIBRATION, 0.0, 0.0, 0.0, 0.0, ACCEPT_AS_IS)
        self._wanted = wanted

    @property
    def done(self) -> bool:
        """Whether the command was answered or has timed out."""
        return not self._wanted or self._request.done

    def update(self, sim_ns: int) -> None:
        """Send the command, and repeat it until it is answered."""
        if self._wanted:
            for message in self._request.poll(sim_ns):
                self._send(message)

    def handle(self, message: Any) -> None:
        """Handle a message of the autopilot."""
        self._request.handle(message, 0)


class Preparation(VehicleDriver):
    """A driver that runs before another driver, on simulation time. It repeats lost messages.

    With `held` the vessel's state is frozen until the autopilot has armed for the first time. `where`: address of the
    autopilot, for messages. The driver gives up without a heartbeat for `heartbeat_s` from the start, or when the
    autopilot still boots after `arm_timeout_s`, the time of other drivers. `complained`: returns the end of the error's
    sentence, also for an error of a step or of the other driver.
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
                    f"{self._where}: no heartbeat of the autopilot in {self._heartbeat_s:.0f} s; check that it "
                    "runs, that this is its MAVLink port, and autopilot.bridge.mavlink"
                )
            return
        if not self._parameters.done:
            self._parameters.update(sim_ns)
            return
        if view.starting and not self._started:
            if sim_ns > self._arm_timeout_s * 1e9:
                texts = "; ".join(dict.fromkeys(list(view.texts)[-2:])) or "nothing"
                raise UserError(
                    f"{self._where}: the autopilot is still starting after {self._arm_timeout_s:g} s and reports: "
                    f"{texts}; correct that and restart it, or increase autopilot.arm_timeout_s"
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
        if not self._view.heard:
            state = "send its first heartbeat"
        elif not self._parameters.done:
            state = "accept its parameters"
        elif not self._started:
            state = "start"
        elif not self._mission.done:
            state = "accept the mission"
        else:
            state = "arm" if self._view.ready_to_arm else "become ready to arm"
        return replace(progress, waits_for=f"the autopilot to {state}")
