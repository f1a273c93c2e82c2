"""Faults of propellers, rudders and battery as the condition of a simulated vessel."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.frames import Array
from sim_core.vessel.condition import ActuatorFault, BatteryFault, Condition, make_condition
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.schema.faults import FaultSpec, PropellerFault, RudderFault


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
        batteries: list[BatteryFault] = []
        for name, fault in faults.items():
            if fault.propeller is not None:
                actuators.append(self._propeller(name, fault.propeller, rotor))
            if fault.rudder is not None:
                actuators.append(self._rudder(name, fault.rudder, rotor))
            if (battery := fault.battery) is not None:
                batteries.append(
                    BatteryFault(battery.added_resistance_ohm, battery.failed_cells, battery.voltage_drop_v)
                )
        return make_condition(self._model, actuators, batteries)

    def _propeller(self, name: str, fault: PropellerFault, rotor: Array) -> ActuatorFault:
        actuator = self._model.actuator_named(fault.which) or fault.which
        held_at = fault.stuck_at
        if held_at is None and fault.stuck:
            held_at = self._keep(name, actuator, rotor)
        return ActuatorFault(actuator, fault.thrust_loss, held_at, fault.reversed)

    def _rudder(self, name: str, fault: RudderFault, rotor: Array) -> ActuatorFault:
        actuator = fault.which or self._model.steering_names[0]
        if fault.jam_angle_deg is None:
            return ActuatorFault(actuator, held_at=self._keep(name, actuator, rotor))
        return ActuatorFault(actuator, held_at=fault.jam_angle_deg / self._model.full_angle_deg(actuator))

    def _keep(self, name: str, actuator: str, rotor: Array) -> float:
        return self._kept.setdefault((name, actuator), float(rotor[self._model.command_names.index(actuator)]))
