"""Controller: converts the heading and speed that the modes command to thrust and steering. It can be replaced.

A controller is a class that takes the Parameters. `Controller` lists its methods and docs/controller.md explains how to
write one. The built-in one is `agent.fcu.control.heading_speed.HeadingSpeedController`.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Protocol, Union

from agent.fcu.parameters import Parameters
from agent.fcu.vehicle_state import CRITICAL, NOTICE, EventQueue
from agent.navigation.measurements import StateEstimate

if TYPE_CHECKING:
    from types import ModuleType

METHODS = ("configure", "restart", "control")


class Order(NamedTuple):
    """Set-point of the controller."""

    heading_rad: float | None
    """Commanded heading, None to command a turn rate."""
    turn_rate_radps: float
    """Commanded turn rate, used without a heading."""
    speed_mps: float
    """Commanded speed over ground, negative astern."""
    ground_speed_mps: float = 0.0
    """Measured speed over ground, negative astern, as the built-in controller uses it."""
    thrust_limited: bool = False
    """Whether the thrust of the last Demand exceeded the propellers. Do not integrate further in that case."""
    steering_limited: bool = False
    """The same for steering."""


class Demand(NamedTuple):
    """Parts of full thrust and full steering in [-1, 1]. The autopilot allocates them."""

    thrust: float
    steering: float
    """Positive to starboard."""
    lateral: float | None = None
    """Part of the full force to starboard, for a vessel that can push sideways. None for any force."""


class Motors(tuple[float, ...]):
    """Commands in [-1, 1] that bypass the allocation: Motors(port, starboard), or one for each actuator."""

    def __new__(cls, *commands: float) -> Motors:
        return super().__new__(cls, commands)


ControllerOutput = Union[Demand, Motors]
STILL = Demand(0.0, 0.0)


class Controller(Protocol):
    """Called from one thread. `control` runs at 50 Hz while armed in a mode that commands a heading or turn rate."""

    def configure(self) -> None:
        """Handle changed parameters."""

    def restart(self) -> None:
        """Reset the integrals. Called when the controller stops steering."""

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> ControllerOutput:
        """Run one step. An exception or a non-finite number makes the outputs neutral for this step."""


MakeController = Callable[[Parameters], Controller]


class ControllerError(ValueError):
    """Raised when a controller cannot be used. The message names the controller, the cause and the remedy."""


def load_controller(spec: str) -> MakeController:
    """Load the class that `module:Class` or `path/to/file.py:Class` names. Raises ControllerError."""
    where, colon, name = spec.rpartition(":")
    if not (colon and where and name.isidentifier()):
        raise ControllerError(f"controller {spec!r} is not valid; write module:Class or path/to/file.py:Class")
    module = _import_module(where, spec)
    candidate: Any = getattr(module, name, None)
    if candidate is None:
        controllers = [
            key
            for key, value in vars(module).items()
            if inspect.isclass(value) and value is not Controller and all(hasattr(value, method) for method in METHODS)
        ]
        offered = ", ".join(controllers) or "no controller"
        raise ControllerError(f"controller {spec!r}: {where} has no {name}; it has {offered}")
    if not inspect.isclass(candidate):
        raise ControllerError(f"controller {spec!r}: {name} is not a class; name a class with {', '.join(METHODS)}")
    missing = [method for method in METHODS if not callable(getattr(candidate, method, None))]
    if missing:
        raise ControllerError(f"controller {spec!r}: {name} has no {', '.join(missing)}; see docs/controller.md")
    make: Any = candidate
    for label, function, arguments in (
        (name, make, ("parameters",)),
        (f"{name}.control", make.control, ("self", "order", "estimate", "dt_s")),
    ):
        try:
            inspect.signature(function).bind(*arguments)
        except (TypeError, ValueError):
            expected = ", ".join(argument for argument in arguments if argument != "self")
            raise ControllerError(
                f"controller {spec!r}: {label} must accept ({expected}); see docs/controller.md"
            ) from None
    checked: MakeController = make
    return checked


def _import_module(where: str, spec: str) -> ModuleType:
    try:
        if not where.endswith(".py"):
            return importlib.import_module(where)
        path = Path(where).resolve()
        if not path.is_file():
            raise ControllerError(f"controller {spec!r}: file {where} does not exist; check the path")
        file = importlib.util.spec_from_file_location(path.stem, path)
        if file is None or file.loader is None:
            raise ControllerError(f"controller {spec!r}: {where} is not a Python file; give a .py file")
        module = importlib.util.module_from_spec(file)
        sys.modules.setdefault(path.stem, module)  # dataclasses look up their module
        file.loader.exec_module(module)
        return module
    except ControllerError:
        raise
    except ModuleNotFoundError as error:
        raise ControllerError(
            f"controller {spec!r}: no module {error.name!r}; check the spelling, or write path/to/file.py:Class"
        ) from None
    except Exception as error:
        raise ControllerError(
            f"controller {spec!r}: {where} cannot be loaded ({_sentence(error)}); correct it"
        ) from error


class ControllerGuard:
    """Protects the autopilot from a controller: an error makes the outputs neutral and has no other effect.

    The first error of a series is an event, as is the end of the series.
    """

    def __init__(self, make: MakeController, parameters: Parameters, events: EventQueue) -> None:
        self.failures = 0
        """Number of errors."""
        self.latest = ""
        """Cause of the last error."""
        self.problem = ""
        """Reason why there is no controller, empty if there is one."""
        self._events = events
        self._failing = False
        self._used = False
        self._controller: Controller | None = None
        try:
            self._controller = make(parameters)
        except Exception as error:  # noqa: BLE001  a user's code
            self.problem = _sentence(error)
            self._fail(self.problem)

    def configure(self) -> None:
        """Forward changed parameters."""
        self._call("configure")

    def restart(self) -> None:
        """Forward a restart, once."""
        if self._used:
            self._used = False
            self._call("restart")

    def control(self, order: Order, estimate: StateEstimate, dt_s: float, commands: int = 2) -> ControllerOutput:
        """Return the controller's output, limited to [-1, 1]. Neutral when the output is invalid.

        commands: number of commands that the vessel takes.
        """
        if self._controller is None:
            return STILL
        self._used = True
        try:
            answer = self._controller.control(order, estimate, dt_s)
            values = answer if isinstance(answer, (Motors, Demand)) else Demand(*answer)
            finite = all(math.isfinite(value) for value in values if value is not None)
        except Exception as error:  # noqa: BLE001  a user's code
            self._fail(_sentence(error))
            return STILL
        if not finite:
            self._fail(f"it returned {', '.join(map(str, values))}")
            return STILL
        if isinstance(values, Motors) and len(values) != commands:
            self._fail(f"it returned {len(values)} commands, but the vessel takes {commands}")
            return STILL
        if self._failing:
            self._failing = False
            self._events.add(NOTICE, "Controller works again")
        if isinstance(values, Motors):
            return Motors(*map(_limited, values))
        thrust, steering, lateral = values
        return Demand(_limited(thrust), _limited(steering), None if lateral is None else _limited(lateral))

    def _call(self, method: str) -> None:
        if self._controller is None:
            return
        try:
            getattr(self._controller, method)()
        except Exception as error:  # noqa: BLE001  a user's code
            self._fail(f"{method}: {_sentence(error)}")

    def _fail(self, why: str) -> None:
        self.failures += 1
        self.latest = why
        if not self._failing:
            self._failing = True
            self._events.add(CRITICAL, f"Controller failed, outputs neutral: {why}")


def _limited(value: float) -> float:
    return 1.0 if value > 1.0 else -1.0 if value < -1.0 else float(value)


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:160].replace("\n", " ")
