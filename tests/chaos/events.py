"""The events of a chaos: what is done to a rig, and what has to follow."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.chaos.rig import AGENT, CLOCK_STEP_S, COMPANION, SILENT_S, Rig
from tests.patience import let_pass, wait_until
from xitl_cli.run.nodes.display import STALLS_S

SILENT = rf"^error: .* stopped answering and was silent for {SILENT_S:g} s"
RESTARTED = rf"^error: .* it was restarted|{SILENT}"
"""A program that needs longer than that to start is silent until then."""
FULL = "^error: .*No space left on device"
QUIET = r"^warning: no motor commands from the agent for 0\.5 s"
COMPANION_QUIET = r"^warning: no word from the companion for 0\.5 s"
GIVEN_UP = "^warning: the run continues without its companion"
STALLED = (
    r"^warning: (?:this machine stalled and the world paused for|\d+ more stalls? in the last \d+ s, the worst) "
    r"([\d.]+) s"
)
"""Of the stalls in a minute, the first has a sentence, and the others have one in common."""
STEPPED = r"^warning: the clock of LC stepped by \+"
INTERRUPTED = "^interrupted"
NO_IMU = "^Failsafe: no IMU"


@dataclass(frozen=True, slots=True)
class Effect:
    """What an event has done.

    sentence: pattern of the one sentence that the terminal of `speaker` shows within `sentence_s`. least: smallest
    value of the number that is its group. starved_s: from when to when, on the monotonic clock, the autopilot had no
    sensors; None if it always had. code: exit code of the host, None while it runs. gone: boards that cannot agree on
    their counts with the host any more. dropping: a full buffer of the system may have lost frames.
    """

    sentence: str
    speaker: str = "host"
    sentence_s: float = 15.0
    least: float | None = None
    starved_s: tuple[float, float] | None = None
    code: int | None = None
    gone: frozenset[str] = frozenset()
    dropping: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """ends: the run ends with it. first: it needs a run that has just begun."""

    name: str
    act: Callable[[Rig, random.Random], Effect]
    ends: bool = False
    first: bool = False


def _ended(rig: Rig) -> None:
    wait_until(lambda: rig.host.gone, "the run does not end")


def _stop(rig: Rig, program: str, seconds: float) -> tuple[float, float]:
    target = rig.host if program == "host" else rig.boards[program]
    began_s = time.monotonic()
    target.send(signal.SIGSTOP)
    let_pass(seconds)
    target.send(signal.SIGCONT)
    return began_s, time.monotonic()


def agent_killed(rig: Rig, draw: random.Random) -> Effect:
    rig.boards[AGENT].kill()
    _ended(rig)
    return Effect(SILENT, code=2, gone=frozenset({AGENT}))


def agent_restarted(rig: Rig, draw: random.Random) -> Effect:
    rig.start_board(AGENT)
    _ended(rig)
    return Effect(RESTARTED, code=2, gone=frozenset({AGENT}))


def agent_restarted_at_another_time(rig: Rig, draw: random.Random) -> Effect:
    rig.start_board(AGENT, clock_offset_s=draw.randrange(1, 10_000_000))
    _ended(rig)
    return Effect(RESTARTED, code=2, gone=frozenset({AGENT}))


def agent_stopped(rig: Rig, draw: random.Random) -> Effect:
    _stop(rig, AGENT, draw.uniform(0.8, 2.0))
    return Effect(QUIET, dropping=True)


def host_killed(rig: Rig, draw: random.Random) -> Effect:
    began_s = time.monotonic()
    rig.host.kill()
    let_pass(1.5)
    return Effect(
        NO_IMU, speaker="station", starved_s=(began_s, time.monotonic()), code=-9, gone=frozenset({AGENT, COMPANION})
    )


def host_stopped(rig: Rig, draw: random.Random) -> Effect:
    seconds = draw.uniform(0.8, 2.0)
    starved_s = _stop(rig, "host", seconds)
    return Effect(STALLED, sentence_s=STALLS_S + 15.0, least=seconds - 0.1, starved_s=starved_s, dropping=True)


def host_interrupted(rig: Rig, draw: random.Random) -> Effect:
    rig.host.send(signal.SIGINT)
    _ended(rig)
    began_s = time.monotonic()
    let_pass(1.0)
    return Effect(INTERRUPTED, starved_s=(began_s, time.monotonic()), code=130)


def companion_killed(rig: Rig, draw: random.Random) -> Effect:
    rig.boards[COMPANION].kill()
    return Effect(GIVEN_UP, gone=frozenset({COMPANION}))


def companion_restarted(rig: Rig, draw: random.Random) -> Effect:
    rig.start_board(COMPANION)
    return Effect(GIVEN_UP, gone=frozenset({COMPANION}))


def companion_stopped(rig: Rig, draw: random.Random) -> Effect:
    _stop(rig, COMPANION, draw.uniform(1.2, 2.0))
    return Effect(COMPANION_QUIET, dropping=True)


def link_cut(rig: Rig, draw: random.Random) -> Effect:
    began_s = time.monotonic()
    rig.line.cut = frozenset({AGENT})
    let_pass(draw.uniform(0.8, 2.0))
    ended_s = time.monotonic()
    rig.line.cut = frozenset()
    return Effect(QUIET, starved_s=(began_s, ended_s))


def link_cut_for_good(rig: Rig, draw: random.Random) -> Effect:
    began_s = time.monotonic()
    rig.line.cut = frozenset({AGENT})
    _ended(rig)
    return Effect(SILENT, starved_s=(began_s, time.monotonic()), code=2, gone=frozenset({AGENT}))


def links_swapped(rig: Rig, draw: random.Random) -> Effect:
    began_s = time.monotonic()
    rig.line.swapped = True
    let_pass(draw.uniform(0.8, 2.0))
    ended_s = time.monotonic()
    rig.line.swapped = False
    return Effect(QUIET, starved_s=(began_s, ended_s))


def disk_full(rig: Rig, draw: random.Random) -> Effect:
    filler = rig.folder / "disk" / "filler"
    fill(filler)
    try:
        _ended(rig)
    finally:
        filler.unlink()
    began_s = time.monotonic()
    let_pass(1.0)
    return Effect(FULL, starved_s=(began_s, time.monotonic()), code=2)


def clock_stepped(rig: Rig, draw: random.Random) -> Effect:
    wait_until(lambda: rig.line.sim_s > CLOCK_STEP_S, "the clock does not step")
    return Effect(STEPPED)


def fill(path: Path) -> None:
    """Write a file until its disk is full."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 20, 4096, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                os.fsync(file.fileno())


EVENTS = (
    Event("agent killed", agent_killed, ends=True),
    Event("agent restarted", agent_restarted, ends=True),
    Event("agent stopped", agent_stopped),
    Event("host killed", host_killed, ends=True),
    Event("host stopped", host_stopped),
    Event("host interrupted", host_interrupted, ends=True),
    Event("companion killed", companion_killed),
    Event("companion restarted", companion_restarted),
    Event("companion stopped", companion_stopped),
    Event("link cut", link_cut),
    Event("link cut for good", link_cut_for_good, ends=True),
    Event("links swapped", links_swapped),
    Event("clock stepped", clock_stepped, first=True),
)
DISK_FULL = Event("disk full", disk_full, ends=True)
"""Needs a small disk, which root alone can mount."""
ANOTHER_TIME = Event("agent restarted at another time", agent_restarted_at_another_time, ends=True)
"""Needs a time namespace."""
