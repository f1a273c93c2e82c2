"""Fault injection on links, agents, actuators and battery, by the schedule of the profile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sim_core.frames import Array
from sim_core.vessel.condition import ActuatorFault, BatteryDamage, Condition, make_condition
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.run.core.faults import FaultSchedule
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
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


class VesselFaults:
    """The condition of one vessel under the active faults.

    A stuck actuator keeps the value that it had when its fault began.
    """

    def __init__(self, model: VesselSpec) -> None:
        self._model = model
        self._kept: dict[tuple[str, str], float] = {}

    def condition(self, faults: Mapping[str, FaultSpec], rotor: Array) -> Condition | None:
        """Return the condition for the active faults, by name, and the (C,) actuators now; None without a fault."""
        self._kept = {key: value for key, value in self._kept.items() if key[0] in faults}
        actuators: list[ActuatorFault] = []
        batteries: list[BatteryDamage] = []
        for name, fault in faults.items():
            if fault.propeller is not None:
                propeller = fault.propeller
                actuator = self._model.actuator_named(propeller.which) or propeller.which
                held_at = propeller.stuck_at
                if held_at is None and propeller.stuck:
                    held_at = self._keep(name, actuator, rotor)
                actuators.append(ActuatorFault(actuator, propeller.thrust_loss, held_at, propeller.reversed))
            if fault.rudder is not None:
                actuator, angle_deg = fault.rudder.which or self._model.steering_names[0], fault.rudder.jam_angle_deg
                if angle_deg is None:
                    held_at = self._keep(name, actuator, rotor)
                else:
                    held_at = angle_deg / self._model.full_angle_deg(actuator)
                actuators.append(ActuatorFault(actuator, held_at=held_at))
            if fault.battery is not None:
                battery = fault.battery
                batteries.append(
                    BatteryDamage(battery.added_resistance_ohm, battery.failed_cells, battery.voltage_drop_v)
                )
        return make_condition(self._model, actuators, batteries)

    def _keep(self, name: str, actuator: str, rotor: Array) -> float:
        return self._kept.setdefault((name, actuator), float(rotor[self._model.command_names.index(actuator)]))
