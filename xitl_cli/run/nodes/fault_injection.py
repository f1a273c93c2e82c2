"""Fault injection on links, agents and the vessel, by the schedule of the profile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.run.core.faults import FaultSchedule
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.core.vessel_faults import VesselFaults
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.world.plant import PlantView

COUNT_RATE_HZ = 1.0


class FaultInjection(RunNode):
    """Activates faults on the links to `agents` and on the vessel of `plant`.

    Links of `autopilots` are counted once more at the end. sample_faults: returns the number of samples that each fault
    has changed, by its name. The sensors inject faults of the profile by themselves and get others by set_sample_fault.
    """

    def __init__(
        self,
        schedule: FaultSchedule,
        plant: PlantView,
        agents: Sequence[AgentConnection],
        autopilots: Sequence[AgentConnection],
        clock: ClockSpec,
        sample_faults: Callable[[], Mapping[str, Mapping[str, int]]] = dict,
        set_sample_fault: Callable[[str, FaultSpec], object] = lambda name, fault: None,
    ) -> None:
        self.schedule = schedule
        self._set_sample_fault = set_sample_fault
        self._plant = plant
        self._vessel = VesselFaults(plant.simulation.vessel.model)
        self._agents = agents
        self._autopilots = autopilots
        self._sample_faults = sample_faults
        self._count_every = max(round(clock.exchange_rate_hz / COUNT_RATE_HZ), 1)
        self._exchanges = 0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        self.schedule.record(step.now_ns, self._recorder)
        if (faults := self.schedule.changed(step.now_ns)) is not None:
            rotor = step.state.vessel.rotor_speed[0]
            self._plant.set_condition(self._vessel.condition(faults, rotor))
        counts = self._exchanges % self._count_every == 0
        self._exchanges += 1
        for agent in self._agents:
            if agent.gone is None:
                agent.apply_faults(step.now_ns, self.schedule.at(step.now_ns, agent.name))
                if counts:
                    self.schedule.count_impaired(*agent.impaired, agent.name)

    def set(self, name: str, fault: FaultSpec) -> None:
        """Set a fault from now on, or change the end of a fault: see FaultSchedule."""
        self.schedule.set(name, fault)
        self._set_sample_fault(name, fault)

    def report(self) -> dict[str, Any]:
        for agent in self._autopilots:
            self.schedule.count_impaired(*agent.impaired, agent.name)
        return {"faults": self.schedule.reports(self._sample_faults())}
