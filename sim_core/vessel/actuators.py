"""Actuators that packages add to a vessel: a sail, a water jet, a winch.

The keys of an actuator (`ActuatorSpec`) make an `Actuator` for one water and one step length. Its state is (N, C): one
value for each of N vessels and C commands, 0 at the start. It is stored after the states of propellers, gears and
rudders, so that fleets, held vessels and recordings treat it in the same way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from sim_core.dataclass import dataclass
from sim_core.keys import Specification

if TYPE_CHECKING:
    from sim_core.environment.spec import Water
    from sim_core.frames import Array
    from sim_core.vessel.spec import VesselSpec


class Actuator:
    """Base class of an actuator of N vessels. It keeps no state of its own. All arrays have one row for each vessel."""

    def spin(self, state: Array, command: Array) -> Array:
        """Return the (N, C) state one step later, for (N, C) commands in [-1, 1]. Default: the command."""
        return command

    def wrench_frd(self, state: Array, nu_r: Array, air_frd_mps: Array) -> Array:
        """Return the (N, 6) force in newtons and moment in newton metres on the body's origin, in body axes.

        state: (N, C). nu_r: (N, 6) velocity and angular velocity of the body relative to the water. air_frd_mps: (N, 3)
        velocity of the body relative to the air.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorSpec(Specification):
    """Base class of the keys below `vehicle.actuators.NAME`, registered in the entry-point group `xitl.actuators`.

    A frozen dataclass derives from it. Its fields are the keys.
    """

    kind: Annotated[str, "name that the package has registered; default: the name of the actuator"] = ""

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of its commands. An actuator with one command may call it "", for the name of the actuator alone."""
        return ("",)

    def make(self, vessel: VesselSpec, water: Water, dt_s: float) -> Actuator:
        """Return the actuator for steps of dt_s. Raises ValueError for a vessel that cannot have it."""
        raise NotImplementedError


class ActuatorError(ValueError):
    """Raised when an added actuator fails, from its exception. The message is one sentence."""

    def __init__(self, name: str, kind: str, problem: str) -> None:
        super().__init__(f"vehicle.actuators.{name}: {problem}")
        self.name = name
        self.kind = kind
