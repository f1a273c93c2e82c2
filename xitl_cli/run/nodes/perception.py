"""The perception sensors of a vessel: lidar, sonar and radar. Their messages go to the companion, if there is one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from agent.wire.codec import Message
from agent.wire.dialect import MAV_SEVERITY_INFO as INFO
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from xitl_cli.record.recorder import PerceptionRecorder
from xitl_cli.run.core.node import RunContext, RunNode, RunStep

SOURCE = "perception"


class PerceptionInstrument(Protocol):
    """A sensor of the companion. address: where other programs may connect to it, or None."""

    @property
    def address(self) -> str | None: ...

    def begin(self, recorder: PerceptionRecorder) -> None:
        """Start the run and record the measurements with `recorder`."""

    def update(self, step: RunStep) -> list[Message]:
        """Return the messages that are due after a physics step."""

    def report(self) -> dict[str, Any]:
        """Return the instrument's part of the summary."""

    def close(self) -> None:
        """Release the instrument's resources."""


class PerceptionNode(RunNode):
    """Instruments by name. `send`: sends to the companion. `warnings`: returns problems of the world at the start."""

    def __init__(
        self,
        instruments: Mapping[str, PerceptionInstrument],
        send: Callable[[Sequence[Message]], None],
        warnings: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self._instruments = instruments
        self._send = send
        self._warnings = warnings

    def begin(self, context: RunContext) -> None:
        recorder = context.recorder
        for text in self._warnings():
            recorder.log(0, WARNING, SOURCE, text)
        for name, instrument in self._instruments.items():
            if instrument.address is not None:
                recorder.log(0, INFO, SOURCE, f"{name} answers its own protocol at {instrument.address}")
            instrument.begin(recorder.perception)

    def sense(self, step: RunStep) -> None:
        for instrument in self._instruments.values():
            messages = instrument.update(step)
            if messages:
                self._send(messages)

    def report(self) -> dict[str, Any]:
        return {"perception": {name: instrument.report() for name, instrument in self._instruments.items()}}

    def close(self) -> None:
        for instrument in self._instruments.values():
            instrument.close()
