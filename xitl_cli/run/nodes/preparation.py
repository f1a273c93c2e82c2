"""What comes before the orders to another autopilot: hear it, set its parameters, hand over the mission."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.nodes.drivers import Driver
from xitl_cli.run.nodes.exchanges import CalibrationAcceptance, MissionUpload, ParameterSetting
from xitl_cli.run.pilot import Progress

SHORTEST_HEARTBEAT_S = 20.0


class Preparation:
    """A Driver that goes before another one: all on simulation time, repeated where something was lost.

    With `moored` the vessel is held until the autopilot has armed for the first time. `where` is its address, for
    people; it is given up when nothing of it was heard for `heartbeat_s` from the start. `complained` ends the sentence
    then and when the other driver gives up.
    """

    def __init__(
        self,
        driver: Driver,
        view: AgentView,
        parameters: ParameterSetting,
        mission: MissionUpload,
        calibration: CalibrationAcceptance,
        moored: bool,
        where: str,
        heartbeat_s: float,
        complained: Callable[[], str] = lambda: "",
    ) -> None:
        self._driver = driver
        self._view = view
        self._parameters = parameters
        self._mission = mission
        self._calibration = calibration
        self._moored = moored
        self._where = where
        self._complained = complained
        self._heartbeat_s = max(heartbeat_s, SHORTEST_HEARTBEAT_S)

    def update(self, sim_ns: int) -> None:
        view = self._view
        if self._moored and view.armed:
            self._moored = False
        if not view.heard:
            if sim_ns > self._heartbeat_s * 1e9:
                raise UserError(
                    f"{self._where}: no heartbeat of the autopilot came in {self._heartbeat_s:.0f} s; check that it "
                    f"runs, that this is its MAVLink port, and autopilot.bridge.mavlink{self._complained()}"
                )
        elif not self._parameters.done:
            self._parameters.update(sim_ns)
        elif not self._mission.done:
            self._mission.update(sim_ns)
        elif not self._calibration.done:
            self._calibration.update(sim_ns)
        else:
            try:
                self._driver.update(sim_ns)
            except UserError as error:
                raise UserError(f"{error}{self._complained()}") from error

    def take(self, message: Any) -> None:
        self._parameters.take(message)
        self._mission.take(message)
        self._calibration.take(message)
        self._driver.take(message)

    def progress(self) -> Progress:
        progress = self._driver.progress()
        if not self._moored or progress.waits_for:
            return progress
        return replace(progress, waits_for=self._waits_for())

    def _waits_for(self) -> str:
        if not self._view.heard:
            return "the autopilot to be heard"
        if not self._parameters.done:
            return "the autopilot to take its parameters"
        if not self._mission.done:
            return "the autopilot to take the mission"
        return "the autopilot to arm" if self._view.ready_to_arm else "the autopilot to become ready to arm"
