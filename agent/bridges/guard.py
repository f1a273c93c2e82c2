"""Guard of a bridge of another package: an exception ends its work and is reported to the host, which ends the run."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Callable, TypeVar

from agent.bridges.injector import Injector, InjectorCounters, InjectorError
from agent.bridges.kinds import BridgeKind
from agent.bridges.vehicle_link import VehicleLink
from agent.timing.clock import Clock
from agent.wire.codec import Message
from agent.wire.dialect import MAV_SEVERITY_CRITICAL, MAV_SEVERITY_DEBUG
from agent.wire.transport import TransportError

T = TypeVar("T")

FAILED = "the bridge of a package, "
"""Start of the text that reports a failure to the host. The traceback is in a text before it."""


class GuardedInjector(Injector):
    """The injector of a package.

    After an exception it is not called again until the next run, except to close it. It then sends nothing, and its
    outputs are neutral. package: its name and version.
    """

    def __init__(self, kind: BridgeKind, name: str, package: str, url: str, vehicle: VehicleLink) -> None:
        self._who = f"{name} ({package})"
        self._say: Callable[[int, str], None] = lambda severity, text: None
        self._now_ns = 0
        self.problem = ""
        """The failure as one sentence, empty without one."""
        try:
            injector = kind.open(url, _TappedVehicle(vehicle, self._guarded_tap))  # type: ignore[arg-type]
        except (InjectorError, TransportError):
            raise
        except Exception as error:
            raise InjectorError(f"sensors: {self._sentence('when it was opened', error)}") from error
        if not isinstance(injector, Injector):
            raise InjectorError(
                f"sensors: {self._who}: its open returned {type(injector).__name__}, which is not an Injector; "
                "correct the plug-in"
            )
        self._injector = injector
        self.title = str(getattr(injector, "title", name))

    def _call(self, default: T, call: Callable[..., T], *arguments: Any) -> T:
        """Return the result of the call, or `default` after a failure."""
        if self.problem:
            return default
        try:
            return call(*arguments)
        except Exception as error:  # noqa: BLE001  the code of a plug-in may raise anything
            self.problem = self._sentence(f"at {self._now_ns * 1e-9:.2f} s", error)
            self._say(MAV_SEVERITY_DEBUG, "".join(traceback.format_exception(type(error), error, error.__traceback__)))
            self._say(MAV_SEVERITY_CRITICAL, FAILED + self.problem)
            return default

    def _sentence(self, when: str, error: Exception) -> str:
        last = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(":")
        where = f"{Path(last.filename).name}:{last.lineno}"
        return f"{self._who} failed {when} ({reason}, {where}); correct the plug-in or use another bridge"

    def _guarded_tap(self, tap: Callable[[Message], None]) -> Callable[[Message], None]:
        return lambda message: self._call(None, tap, message)

    @property
    def counts(self) -> InjectorCounters:  # type: ignore[override]
        counts = getattr(self._injector, "counts", None)
        return counts if isinstance(counts, InjectorCounters) else InjectorCounters()

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self._say = say
        self._now_ns = clock.now_ns()
        self.problem = ""
        self._call(None, self._injector.reset, clock, lockstep, say)

    def handle(self, message: Message, now_ns: int) -> None:
        self._now_ns = now_ns
        self._call(None, self._injector.handle, message, now_ns)

    def repeat(self, now_ns: int) -> None:
        self._call(None, self._injector.repeat, now_ns)

    def serve(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._call(None, self._injector.serve, now_ns)

    def advance(self, now_ns: int) -> bool:
        self._now_ns = now_ns
        return self._call(True, self._injector.advance, now_ns)

    def run_on(self, now_ns: int) -> bool:
        return self._call(True, self._injector.run_on, now_ns)

    def pulses(self) -> Sequence[int] | None:
        nothing: Sequence[int] | None = ()
        return self._call(nothing, self._injector.pulses)

    def commands(self) -> Sequence[float] | None:
        nothing: Sequence[float] | None = ()
        return self._call(nothing, self._injector.commands)

    def descriptors(self) -> Sequence[int]:
        return self._call((), self._injector.descriptors)

    @property
    def addresses(self) -> tuple[str, ...]:
        return self._call((), lambda: tuple(map(str, self._injector.addresses)))

    def close(self) -> None:
        try:
            self._injector.close()
        except Exception as error:  # noqa: BLE001  nothing depends on it any more
            self.problem = self.problem or self._sentence("when it was closed", error)


class _TappedVehicle:
    """The line to the autopilot, whose taps are guarded."""

    def __init__(self, vehicle: VehicleLink, guarded: Callable[[Callable[[Message], None]], Any]) -> None:
        self._vehicle = vehicle
        self._guarded = guarded

    def add_tap(self, tap: Callable[[Message], None]) -> None:
        self._vehicle.add_tap(self._guarded(tap))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._vehicle, name)
