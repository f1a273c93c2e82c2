"""Faults that the host requests: of the agent's outgoing link, its clock and its processors."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from math import inf, isfinite
from typing import TYPE_CHECKING

from agent.timing.clock import Clock, SteppedClock
from agent.timing.realtime import ordinary
from agent.timing.tasks import Executor
from agent.wire import dialect
from agent.wire.codec import Message
from agent.wire.impaired import NO_FAULTS, OVERTAKEN_S, ImpairedTransport, LinkFaults
from agent.wire.transport import Transport

if TYPE_CHECKING:
    import subprocess

LAPSE_NS = 10_000_000_000
"""Time without a request after which link and processors recover. The host repeats the active faults once a second."""

_MOST_US = 60_000_000  # limit of delay and jitter
_MOST_AHEAD_NS = 10**18  # 31 years: a board without the date is not farther off
# The period is 10 ms. The program ends when its standard input closes, which happens when its parent ends.
_BURN = """
import os, select, sys, time
share, cpu = float(sys.argv[1]), int(sys.argv[2])
if cpu >= 0:
    try:
        os.sched_setaffinity(0, (cpu,))
    except OSError:
        pass
while True:
    until = time.monotonic() + 0.01 * share
    while time.monotonic() < until:
        pass
    if select.select((0,), (), (), 0.01 * (1.0 - share))[0]:
        sys.exit()
"""


class AgentFaults:
    """Active faults, on the transport that `wrap` returned and on the clock of the run.

    `answering`: the next message answers XITL_RUN and is exempt, as is the answer to a tick in lockstep. In lockstep,
    time does not advance by itself, and faults of clock, delay and load have no effect.
    """

    def __init__(self, monotonic: Clock) -> None:
        self.answering = False
        self._monotonic = monotonic
        self._clock: SteppedClock | None = None
        self._executor: Executor | None = None
        self._transport: ImpairedTransport | None = None
        self._lost_before = 0
        self._load: CpuLoad | None = None
        self._last: tuple[float, ...] = ()
        self._heard_ns: int | None = None

    def wrap(self, transport: Transport) -> ImpairedTransport:
        """Return the same transport, with faults applied."""
        self._transport = ImpairedTransport(transport, self._is_exempt)
        return self._transport

    def _is_exempt(self, message_id: int) -> bool:
        return self.answering or (self._clock is None and message_id == dialect.MAVLINK_MSG_ID_XITL_ACTUATORS)

    @property
    def impaired(self) -> int:
        """Number of frames dropped since the run began."""
        return 0 if self._transport is None else self._transport.lost - self._lost_before

    def start_run(self, clock: SteppedClock | None, executor: Executor) -> None:
        """Start a run without faults. clock: clock of the run, None in lockstep. executor: runs its tasks."""
        self.end()
        self._clock = clock
        self._executor = executor
        if self._transport is not None:
            self._lost_before = self._transport.lost
            self._transport.patience_s = inf if clock is None else OVERTAKEN_S

    def handle(self, message: Message) -> Iterator[str]:
        """Apply the faults of XITL_FAULTS. A repetition changes nothing. Yield sentences for the user."""
        self._heard_ns = self._monotonic.now_ns()
        wanted = (
            message.delay_usec, message.jitter_usec, message.loss, message.duplicate, message.reorder, message.cut,
            message.clock_offset_ns, message.clock_skew_ppm, message.cpu_load, message.seed,
        )  # fmt: skip
        if wanted == self._last:
            return
        self._last = wanted
        problem = _problem(message)
        if problem:
            yield f"Faults refused: {problem}"
            return
        if self._transport is not None:
            delay_s, jitter_s = message.delay_usec * 1e-6, message.jitter_usec * 1e-6
            if self._clock is None:
                delay_s = jitter_s = 0.0
            cut = bool(message.cut)
            faults = LinkFaults(delay_s, jitter_s, message.loss, message.duplicate, message.reorder, cut)
            self._transport.set(faults, message.seed)
        if self._clock is None:
            return
        offset_ns = message.clock_offset_ns
        if not any(wanted[:-1]):  # all faults end, but time does not go back
            offset_ns = self._clock.offset_ns
        before_ns = self._clock.offset_ns
        if self._clock.disturb(offset_ns, message.clock_skew_ppm):
            if self._executor is not None:
                self._executor.clock_stepped(offset_ns - before_ns)
        else:
            ahead_s = self._clock.offset_ns * 1e-9
            yield (
                f"Fault refused: clock offset {offset_ns * 1e-9:g} s; "
                f"the clock is {ahead_s:g} s ahead and never steps back"
            )
        if self._load is None and message.cpu_load > 0.0:
            self._load = CpuLoad()
        problem = "" if self._load is None else self._load.set(message.cpu_load)
        if problem:
            yield f"Fault refused: {problem}"

    def lapse(self) -> None:
        """End faults that the host no longer requests. Called periodically. The clock keeps its offset."""
        if self._heard_ns is not None and self._monotonic.now_ns() - self._heard_ns > LAPSE_NS:
            self.end()

    def end(self) -> None:
        """End the faults of link and processors, and all started processes."""
        self._last, self._heard_ns = (), None
        if self._transport is not None:
            self._transport.set(NO_FAULTS)
        if self._load is not None:
            self._load.close()


def _problem(message: Message) -> str:
    """Return the error of an invalid request, or an empty text."""
    for name in ("loss", "duplicate", "reorder", "cpu_load"):
        share = getattr(message, name)
        if not 0.0 <= share <= 1.0:
            return f"{name} {share:g} is not within 0 to 1"
    for name in ("delay_usec", "jitter_usec"):
        if getattr(message, name) > _MOST_US:
            return f"{name} {getattr(message, name)} is above {_MOST_US}"
    if abs(message.clock_offset_ns) > _MOST_AHEAD_NS:
        return f"clock_offset_ns {message.clock_offset_ns} is not within {_MOST_AHEAD_NS}"
    skew_ppm = message.clock_skew_ppm
    return "" if isfinite(skew_ppm) and abs(skew_ppm) < 1e5 else f"clock_skew_ppm {skew_ppm:g} is not within 100000"


class CpuLoad:
    """Load that keeps `share` of every processor busy, 0 to 1; 0 at first."""

    def __init__(self) -> None:
        self.share = 0.0
        self._processes: list[subprocess.Popen[bytes]] = []

    def set(self, share: float) -> str:
        """Set the share. The same share changes nothing. Return the reason for a failure, or an empty text."""
        if share == self.share:
            return ""
        self.close()
        if share <= 0.0:
            return ""
        import subprocess  # only where a load is asked for: it costs a board memory

        processors = range(os.cpu_count() or 1) if hasattr(os, "sched_setaffinity") else (-1,)
        try:
            with ordinary():
                for cpu in processors:
                    self._processes.append(
                        subprocess.Popen(
                            [sys.executable, "-S", "-E", "-c", _BURN, f"{min(share, 1.0)}", f"{cpu}"],
                            stdin=subprocess.PIPE,
                            stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL,
                        )
                    )
        except OSError as error:
            self.close()
            return f"no load: {sys.executable} cannot be started ({error.strerror})"
        self.share = share
        return ""

    @property
    def processes(self) -> list[int]:
        """Process ids of the load."""
        return [process.pid for process in self._processes]

    def close(self) -> None:
        """End the load."""
        processes, self._processes, self.share = self._processes, [], 0.0
        for process in processes:
            process.kill()
        for process in processes:
            if process.stdin is not None:
                process.stdin.close()
            process.wait()
