"""A battery that feeds all propellers: voltage, current and charge, and the loss of speed at low voltage.

    I   = I_h + I_m sum_i w_i |n_i|^3          the power of a propeller at rest goes with the cube of its speed
    V_0 = V_empty + (V_full - V_empty) s       open circuit at the state of charge s
    V   = V_0 - R I

n_i is the speed of propeller i and w_i its share of all thrust at rest. A speed controller sets the voltage at its
motor as a share of V. Full command therefore gives less speed at a lower voltage. The thrusts of a vessel's propellers
are valid for its healthy battery. A fault leaves a share of the speed: V over the voltage of the healthy battery at the
same charge and current. Without a fault, the share is exactly 1.
"""

from __future__ import annotations

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.state_class import state_class
from sim_core.vessel.spec import BatterySpec, VesselSpec

COULOMB_PER_AH = 3600.0


@state_class
class BatteryState:
    """State of N batteries, all (N,)."""

    used_as: Array
    """Charge taken out so far."""
    voltage_v: Array
    """Voltage at the terminals."""
    current_a: Array
    """Current."""


@dataclass(frozen=True, slots=True, eq=False)
class BatteryCondition:
    """Faults of N batteries, all (N,)."""

    added_resistance_ohm: Array
    """Resistance added in series."""
    cell_share: Array
    """Share of the cells that still have voltage."""
    voltage_drop_v: Array
    """Voltage drop at any current."""


@dataclass(frozen=True, slots=True, eq=False)
class Battery:
    """Constants of a vessel's battery."""

    spec: BatterySpec
    share: Array  # (P,) of the current that each propeller draws at full speed
    dt_s: float

    @classmethod
    def from_spec(cls, model: VesselSpec, dt_s: float) -> Battery | None:
        """Return the battery of a model, None for a model without a battery."""
        if model.battery is None:
            return None
        thrust_n = np.array([propeller.static_thrust_n(1000.0)[0] for propeller in model.propellers])
        return cls(model.battery, thrust_n / thrust_n.sum(), dt_s)

    def initial(self, vessels: int) -> BatteryState:
        """Return the spec's initial charge, with the current of all loads except the propellers."""
        full = np.ones(vessels)
        used_as = full * (1.0 - self.spec.initial_charge) * self.spec.capacity_ah * COULOMB_PER_AH
        current_a = full * self.spec.idle_current_a
        return BatteryState(used_as, self._healthy_v(used_as, current_a), current_a)

    def step(self, state: BatteryState, speed: Array, condition: BatteryCondition | None) -> tuple[BatteryState, Array]:
        """Return the state one step later for (N, P) speeds, and the remaining share of full speed (N, 1)."""
        spec = self.spec
        current_a = spec.idle_current_a + spec.full_current_a * (np.abs(speed) ** 3 @ self.share)
        used_as = state.used_as + current_a * self.dt_s
        healthy_v = self._healthy_v(used_as, current_a)
        if condition is None:
            return BatteryState(used_as, healthy_v, current_a), np.ones((len(speed), 1))
        voltage_v = self._open_circuit_v(used_as) * condition.cell_share - condition.voltage_drop_v
        voltage_v -= (spec.resistance_ohm + condition.added_resistance_ohm) * current_a
        voltage_v = np.maximum(voltage_v, 0.0)
        left = np.minimum(voltage_v / np.maximum(healthy_v, 1e-9), 1.0)
        return BatteryState(used_as, voltage_v, current_a), left[:, None]

    def _healthy_v(self, used_as: Array, current_a: Array) -> Array:
        return np.maximum(self._open_circuit_v(used_as) - self.spec.resistance_ohm * current_a, 0.0)

    def _open_circuit_v(self, used_as: Array) -> Array:
        spec = self.spec
        charge = np.clip(1.0 - used_as / (spec.capacity_ah * COULOMB_PER_AH), 0.0, 1.0)
        voltage_v: Array = spec.empty_voltage_v + (spec.full_voltage_v - spec.empty_voltage_v) * charge
        return voltage_v
