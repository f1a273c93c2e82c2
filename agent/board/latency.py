"""`doctor --latency`: start lateness of a periodic task, next to a bare sleep, and the round trip to an agent.

Three measurements take turns for each scheduling and load:

xitl   a task of `agent.timing.tasks.Executor` whose loop waits as an agent and a run in real time do
bare   a loop of `clock_nanosleep` until absolute instants, the least that Python can do on this machine
link   clock exchanges with an agent in another process, or at an address

The report is a dictionary for JSON, the same on this machine and on a board.
"""

from __future__ import annotations

import gc
import os
import platform
import socket
import subprocess
import sys
import time
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from textwrap import wrap
from typing import Any, Callable

import agent
from agent.machine import read_machine
from agent.options import WAITS_AT
from agent.timing.clock import wait_readable
from agent.timing.deadline import DeadlineWait, absolute_sleep
from agent.timing.realtime import DEFAULT_PRIORITY, ordinary, schedule, unschedule
from agent.timing.sync import ClockSync
from agent.timing.tasks import BINS, Executor, histogram_bin
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.transport import TransportError, open_transport

FIFO, OTHER = "SCHED_FIFO", "SCHED_OTHER"
XITL, BARE = "xitl", "bare"
TURN_S = 1.0
"""The loops take turns of this length, so that other programs disturb all of them alike."""
PERIOD_SHARE = 4
RULE = f"p99.9 of start lateness below 1/{PERIOD_SHARE} of the period"
EXCHANGE_HZ = 50.0
ANSWER_S = 1.0
START_S = 20.0
LOAD_BYTES = 16 << 20
MOST_LOADS = 8
START_DELAY_NS = 1_000_000
WIDTH = 80
_BAR = 24
_HOST_IDS = 255, 190
"""MAVLink system and component of the exchanges, those of a simulation host."""


class LatencyError(Exception):
    """A measurement is not possible. The text names the cause and the remedy."""


@dataclass(frozen=True)
class LatencyPlan:
    """What to measure. Raises LatencyError for impossible values."""

    rates_hz: tuple[float, ...]
    """Rates of the periodic task."""
    duration_s: float
    """Measured time of each loop at each rate, for each scheduling and load."""
    loaded: bool = False
    """Whether to measure a second time under load."""
    agent_url: str = ""
    """Address of a waiting agent; empty to start one in another process."""

    def __post_init__(self) -> None:
        if not self.rates_hz or not all(1.0 <= rate_hz <= 10_000.0 for rate_hz in self.rates_hz):
            raise LatencyError(f"rates {list(self.rates_hz)} Hz cannot be measured; use rates from 1 to 10000 Hz")
        if not 0.1 <= self.duration_s <= 36_000.0:
            raise LatencyError(f"a duration of {self.duration_s:g} s cannot be measured; use 0.1 s to 36000 s")

    @property
    def total_s(self) -> float:
        """Approximate time of the whole measurement, with SCHED_FIFO."""
        return 2 * (1 + self.loaded) * (2 * len(self.rates_hz) + 1) * self.duration_s


def measure_link(url: str, duration_s: float) -> dict[str, Any]:
    """Return the row of `links` for a waiting agent. Raises LatencyError when it does not answer."""
    trips = RoundTrips(url)
    try:
        return {"scheduling": OTHER, "load": False, **trips.measure(duration_s)}
    finally:
        trips.close()


def measure(plan: LatencyPlan, tell: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Measure, and return the report. tell: shows progress. Raises LatencyError when the agent cannot be reached."""
    machine = read_machine()
    problem = fifo_problem()
    loops: list[dict[str, Any]] = []
    links: list[dict[str, Any]] = []
    for scheduling in (OTHER, *(() if problem else (FIFO,))):
        priority = DEFAULT_PRIORITY if scheduling == FIFO else 0
        with ExitStack() as opened:
            trips = RoundTrips(plan.agent_url or opened.enter_context(agent_process(priority)))
            opened.callback(trips.close)
            for loaded in (False, True) if plan.loaded else (False,):
                condition = {"scheduling": scheduling, "load": loaded}
                tell(f"{scheduling}, {'under load' if loaded else 'without load'}")
                with ExitStack() as conditions:
                    if loaded:
                        conditions.enter_context(load())
                    conditions.enter_context(scheduled(priority))
                    loops += [{**condition, **row} for row in measure_loops(plan.rates_hz, plan.duration_s)]
                    links.append({**condition, **trips.measure(plan.duration_s)})
    return {
        "xitl": agent.__version__,
        "machine": {**machine._asdict(), "python": platform.python_version()},
        "duration_s": plan.duration_s,
        "fifo": {"permitted": not problem, "priority": 0 if problem else DEFAULT_PRIORITY, "problem": problem},
        "loops": loops,
        "links": links,
        "rule": RULE,
        "rates": [held_rate(loops, rate_hz) for rate_hz in plan.rates_hz],
    }


def held_rate(loops: Sequence[Mapping[str, Any]], rate_hz: float) -> dict[str, Any]:
    """Return whether a rate is held by `RULE` with the best permitted scheduling, in all measured loads."""
    rows = [row for row in loops if row["loop"] == XITL and row["rate_hz"] == rate_hz]
    scheduling = FIFO if any(row["scheduling"] == FIFO for row in rows) else OTHER
    rows = [row for row in rows if row["scheduling"] == scheduling]
    p999_us = max(row["p999_us"] for row in rows)
    return {
        "rate_hz": rate_hz,
        "scheduling": scheduling,
        "holds": all(row["holds"] for row in rows),
        "limit_us": 1e6 / rate_hz / PERIOD_SHARE,
        "p999_us": p999_us,
        "worst_us": max(row["worst_us"] for row in rows),
        "highest_rate_hz": 1e6 / (PERIOD_SHARE * max(p999_us, 1.0)),
    }


def holds_all(report: Mapping[str, Any]) -> bool:
    """Whether a report says that every rate is held."""
    return all(rate["holds"] for rate in report["rates"])


# The loops


def measure_loops(rates_hz: Sequence[float], duration_s: float) -> Iterator[dict[str, Any]]:
    """Yield a row for each rate and loop."""
    sleep_until = absolute_sleep()
    for rate_hz in rates_hz:
        loops: dict[str, Callable[[int, float, array[int]], None]] = {XITL: xitl_loop}
        if sleep_until is not None:
            loops[BARE] = bare_loop(sleep_until)
        cycles = max(ceil(duration_s * rate_hz), 2)
        turn = max(ceil(min(TURN_S, duration_s) * rate_hz), 2)
        samples = {name: array("q") for name in loops}
        while cycles > 0:
            for name, loop in loops.items():
                late_ns = array("q", bytes(8 * min(turn, cycles)))
                loop(len(late_ns), rate_hz, late_ns)
                samples[name].extend(late_ns)
            cycles -= turn
        for name in loops:
            yield {"loop": name, "rate_hz": rate_hz, **lateness_row(samples[name], rate_hz)}


def xitl_loop(cycles: int, rate_hz: float, late_ns: array[int]) -> None:
    """Run a task as an agent in real time does: wait for a socket and the deadline, then run the due tasks.

    late_ns: gets the lateness of each start, `cycles` of them.
    """
    now_ns = time.monotonic_ns
    begun_ns = 0

    def task(begin_ns: int) -> None:
        nonlocal begun_ns
        begun_ns = begin_ns

    executor = Executor(_SystemClock())
    executor.add("periodic", rate_hz, task)
    wait = DeadlineWait()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inputs, wait.deferred():
        inputs.bind(("127.0.0.1", 0))
        descriptors = (inputs.fileno(),)
        executor.restart(now_ns() + START_DELAY_NS)
        for number in range(cycles):
            due_ns = executor.next_due_ns or 0
            while (left_ns := due_ns - now_ns()) > 0:
                wait.until(left_ns, lambda seconds: wait_readable(descriptors, seconds))
            executor.run_due(now_ns())
            late_ns[number] = begun_ns - due_ns


class _SystemClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


def bare_loop(sleep_until: Callable[[int], None]) -> Callable[[int, float, array[int]], None]:
    """Return the loop that only sleeps until each instant. Like an executor, it skips the cycles that it missed."""

    def loop(cycles: int, rate_hz: float, late_ns: array[int]) -> None:
        now_ns = time.monotonic_ns
        collects = gc.isenabled()
        gc.disable()
        start_ns, index = now_ns() + START_DELAY_NS, 0
        for number in range(cycles):
            due_ns = start_ns + round(index * 1e9 / rate_hz)
            sleep_until(due_ns)
            begun_ns = now_ns()
            late_ns[number] = begun_ns - due_ns
            index = max(index + 1, int((begun_ns - start_ns) * rate_hz / 1e9))
        if collects:
            gc.enable()

    return loop


def lateness_row(late_ns: Sequence[int], rate_hz: float) -> dict[str, Any]:
    """Return the figures of one loop: quantiles, histogram by `agent.timing.tasks.histogram_bin`, and the rule."""
    figures = quantiles_us(late_ns)
    return {**figures, "holds": figures["p999_us"] < 1e6 / rate_hz / PERIOD_SHARE}


def quantiles_us(times_ns: Sequence[int]) -> dict[str, Any]:
    """Return count, p50, p99, p99.9 and maximum in microseconds, and the histogram. A quantile is a measured value."""
    ordered = sorted(times_ns)
    bins = [0] * BINS
    for value in ordered:
        bins[histogram_bin(value)] += 1
    figures: dict[str, Any] = {"samples": len(ordered)}
    for name, share in (("p50_us", 0.5), ("p99_us", 0.99), ("p999_us", 0.999), ("worst_us", 1.0)):
        figures[name] = round(ordered[max(ceil(share * len(ordered)), 1) - 1] * 1e-3, 3) if ordered else None
    return {**figures, "histogram": bins}


# Scheduling and load


def fifo_problem() -> str:
    """Return why SCHED_FIFO is not permitted, with the remedy; empty if it is permitted."""
    try:
        with scheduled(DEFAULT_PRIORITY):
            return ""
    except LatencyError as error:
        return str(error)


@contextmanager
def scheduled(priority: int) -> Iterator[None]:
    """Context with SCHED_FIFO at `priority`; 0: without. Raises LatencyError when it is not permitted."""
    if not priority:
        with ordinary():
            yield
        return
    problem = schedule(priority)
    if problem:
        raise LatencyError(problem)
    try:
        yield
    finally:
        unschedule()


_LOAD = """
import select
block = bytearray({size})
while not select.select([0], (), (), 0)[0]:
    block[:] = bytes(block)
    sum(range(100_000))
"""


@contextmanager
def load() -> Iterator[int]:
    """Context with one process for each processor, at most `MOST_LOADS`, that computes and copies `LOAD_BYTES`.

    The processes end with this one, even when it is killed: their standard input closes. Returns their number.
    """
    count = min(max(len(_processors()), 1), MOST_LOADS)
    command = [sys.executable, "-c", _LOAD.format(size=LOAD_BYTES)]
    with ordinary():
        processes = [subprocess.Popen(command, stdin=subprocess.PIPE) for _ in range(count)]
    try:
        yield count
    finally:
        for process in processes:
            process.communicate()


def _processors() -> Sequence[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return range(os.cpu_count() or 1)


# The link


@contextmanager
def agent_process(priority: int) -> Iterator[str]:
    """Context with an agent in another process. Returns its address. priority: of SCHED_FIFO, 0 without.

    Raises LatencyError when it does not start.
    """
    command = [sys.executable, "-m", "agent", "--link", "udp://127.0.0.1:0", "--attached"]
    if priority:
        command.append(f"--realtime={priority}")
    root = str(Path(agent.__file__).parent.parent)  # a folder, or the archive
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    with ordinary(), subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if WAITS_AT not in line:
                raise LatencyError("an agent could not be started here; run `xitl agent` to see the reason")
            yield line.split()[-1]
        finally:
            process.terminate()


class RoundTrips:
    """Exchanges of clocks with a waiting agent. Its clock is compared over all of them."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._sync = ClockSync()
        try:
            self._link = Link(open_transport(url, listen=False), *_HOST_IDS)
        except TransportError as error:
            raise LatencyError(str(error)) from None
        self._number = 0
        began_s = time.monotonic()
        while self._exchange() is None:
            if time.monotonic() - began_s > START_S:
                self.close()
                raise LatencyError(f"{url}: no agent answers; start one there, or check the address")

    def close(self) -> None:
        """Close the link."""
        self._link.transport.close()

    def measure(self, duration_s: float) -> dict[str, Any]:
        """Exchange at `EXCHANGE_HZ`, and return the round trips and the relation of the clocks."""
        trips_ns: list[int] = []
        lost = 0
        due_s = time.monotonic()
        for _ in range(max(ceil(duration_s * EXCHANGE_HZ), 1)):
            due_s += 1.0 / EXCHANGE_HZ
            time.sleep(max(due_s - time.monotonic(), 0.0))
            trip_ns = self._exchange()
            if trip_ns is None:
                lost += 1
            else:
                trips_ns.append(trip_ns)
        return {"agent": self.url, "lost": lost, **quantiles_us(trips_ns), "clock": self._clock()}

    def _clock(self) -> dict[str, Any]:
        estimate = self._sync.estimate
        return {
            "offset_us": estimate.offset_ns * 1e-3,
            "offset_bound_us": estimate.asymmetry_bound_ns * 1e-3,
            "drift_ppm": estimate.drift_ppm,
            "drift_error_ppm": estimate.drift_error_ppm,
            "steps": estimate.steps,
        }

    def _exchange(self) -> int | None:
        """Return the round trip without the agent's own time; None without a usable answer."""
        self._number += 1
        t1_ns = time.monotonic_ns()
        self._link.send(dialect.MAVLink_xitl_timesync_message(t1_ns, 0, 0, self._number, self._number))
        until_s = time.monotonic() + ANSWER_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            for message in self._link.receive(left_s):
                t4_ns = time.monotonic_ns()
                if message.get_msgId() != dialect.MAVLINK_MSG_ID_XITL_TIMESYNC or message.t1_ns != t1_ns:
                    continue
                if self._sync.add(t1_ns, message.t2_ns, message.t3_ns, t4_ns):
                    return t4_ns - t1_ns - int(message.t3_ns - message.t2_ns)
                return None
        return None


# Text


def report_text(report: Mapping[str, Any]) -> str:
    """Return a report for a terminal of 80 columns: tables, histograms, and a sentence for each rate."""
    machine, fifo = report["machine"], report["fifo"]
    highest_hz = [rate["highest_rate_hz"] for rate in report["rates"]]
    python = f"Python {machine['python']}, {machine['processors']} processors"
    lines = wrap(f"{machine['name']}, {machine['kernel']}, {python}", WIDTH)
    if not fifo["permitted"]:
        lines += wrap(f"without SCHED_FIFO: {fifo['problem']}", WIDTH)
    lines += ["", f"start lateness in µs, {report['duration_s']:g} s for each loop"]
    lines.append(f"{'scheduling':<12}{'load':<5}{'Hz':>6}  {'loop':<5}{'samples':>9}{_heads()}")
    for row in report["loops"]:
        lines.append(
            f"{row['scheduling']:<12}{_yes(row['load']):<5}{row['rate_hz']:>6g}  {row['loop']:<5}{row['samples']:>9}"
            f"{_figures(row)}"
        )
    for url in dict.fromkeys(row["agent"] for row in report["links"]):
        lines += ["", *_link_lines(url, [row for row in report["links"] if row["agent"] == url])]
    for row in report["loops"]:
        if row["loop"] == XITL:
            bare = next((other for other in report["loops"] if _is_bare_of(other, row)), None)
            lines += ["", *_histogram_lines(row, bare)]
    lines += ["", f"rule: {report['rule']}"]
    lines += [_rate_sentence(rate) for rate in report["rates"]]
    lines.append(f"by the largest of these p99.9, rates up to {min(highest_hz):.0f} Hz can be held")
    return "\n".join(lines)


def _link_lines(url: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield f"round trip in µs to the agent at {url}"
    yield f"{'scheduling':<12}{'load':<5}{'samples':>7}{'lost':>4}{_heads()}{'± offset':>9}{'drift ppm':>15}"
    for row in rows:
        clock = row["clock"]
        drift = f"{clock['drift_ppm']:.1f} ± {clock['drift_error_ppm']:.1f}"
        yield (
            f"{row['scheduling']:<12}{_yes(row['load']):<5}{row['samples']:>7}{row['lost']:>4}{_figures(row)}"
            f"{clock['offset_bound_us']:>9.0f}{drift:>15}"
        )
    yield f"its clock is {rows[-1]['clock']['offset_us'] * 1e-6:+.6f} s from this one"


def _is_bare_of(other: Mapping[str, Any], row: Mapping[str, Any]) -> bool:
    return other["loop"] == BARE and all(other[key] == row[key] for key in ("scheduling", "load", "rate_hz"))


def _histogram_lines(row: Mapping[str, Any], bare: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield the lines of a histogram: the task on the left, the bare loop on the right."""
    condition = f"{row['scheduling']}, {row['rate_hz']:g} Hz{', under load' if row['load'] else ''}"
    yield condition
    yield f"{'':11}  {XITL:<{_BAR + 8}}  {BARE if bare else ''}".rstrip()
    columns = [row["histogram"], *([bare["histogram"]] if bare else [])]
    used = [number for number in range(BINS) if any(column[number] for column in columns)]
    for number in range(used[0], used[-1] + 1):
        cells = "".join(f"  {_bar(column[number], sum(column))}" for column in columns)
        label = f"≥ {1 << number} µs" if number == BINS - 1 else f"< {2 << number} µs"
        yield f"{label:>11}{cells}".rstrip()


def _bar(count: int, total: int) -> str:
    """Return a bar of the share with its number; one dot for a count above 0 that is too small for a bar."""
    length = round(_BAR * count / total)
    return f"{('█' * length or ('·' if count else '')):<{_BAR}}{count if count else '':>8}"


def _rate_sentence(rate: Mapping[str, Any]) -> str:
    verb = "is held" if rate["holds"] else "is NOT held"
    return (
        f"{rate['rate_hz']:g} Hz {verb} with {rate['scheduling']}: p99.9 {rate['p999_us']:.0f} µs, "
        f"limit {rate['limit_us']:.0f} µs, worst {rate['worst_us']:.0f} µs"
    )


def _heads() -> str:
    return "".join(f"{name:>7}" for name in ("p50", "p99", "p99.9", "worst"))


def _figures(row: Mapping[str, Any]) -> str:
    values = (row[name] for name in ("p50_us", "p99_us", "p999_us", "worst_us"))
    return "".join(f"{'–' if value is None else format(value, '.0f'):>7}" for value in values)


def _yes(flag: bool) -> str:
    return "yes" if flag else "no"
