"""A run from profile to summary: make the nodes, reach them, loop, close everything whatever happens."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from agent import __version__
from xitl_cli.errors import UserError
from xitl_cli.extras import PERCEPTION
from xitl_cli.profile import Profile, resolved_yaml
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.compose import RunSetup, compose, link_names
from xitl_cli.run.core import directory
from xitl_cli.run.core.node import RunContext, SimulationClock, VesselNodes
from xitl_cli.run.core.pace import Lockstep, Pace, Realtime
from xitl_cli.run.core.reports import ClockReport, Ending
from xitl_cli.run.core.seeds import Seeds
from xitl_cli.run.links.connection import StoppedWaitingError
from xitl_cli.run.links.stations import StationAddresses
from xitl_cli.run.loop import Loop
from xitl_cli.run.summary import RunOutcome, Sections, merged, summary_of
from xitl_cli.run.view import View
from xitl_cli.run.world.scene import make_scene
from xitl_cli.run.world.scenery import Scenery
from xitl_cli.run.world.world import build_plant

if TYPE_CHECKING:
    from xitl_cli.logs.model.log import Log

COMPLETED, INCOMPLETE, USER_ERROR, INTERRUPTED = 0, 1, 2, 130


@dataclass(frozen=True, slots=True)
class Result:
    """A run that is over.

    summary: the content of summary.json (docs/recording.md). directory: where the run is kept. exit_code: as of
    `xitl sim`.
    """

    summary: dict[str, Any]
    directory: Path
    exit_code: int

    @property
    def completed(self) -> bool:
        """Whether the driver did all it was there for: mission, script or replay."""
        done: bool = self.summary["driver"]["completed"]
        return done and self.exit_code == COMPLETED

    @property
    def verdict(self) -> dict[str, Any]:
        """Whether it was completed and, in real time, kept real time, with the reasons: `verdict` of summary.json."""
        found: dict[str, Any] = self.summary["verdict"]
        return found

    @property
    def recording(self) -> Path:
        """The MCAP file with every topic."""
        return self.directory / directory.RECORDING

    def open_log(self) -> Log:
        """The recording, opened for reading. Close it, or use it in a `with`."""
        from xitl_cli.logs import open_log

        return open_log(self.recording)


def run(
    profile: Profile,
    out: Path,
    overwrite: bool,
    make_view: Callable[[], View],
    timed: bool = False,
    warnings: Sequence[str] = (),
) -> Result:
    """One run, kept in `out`.

    timed: its duration was asked for, so that reaching it is what was wanted. warnings: of the profile, told beside
    those of the world.

    Raises UserError, leaving nothing behind, when the profile cannot run, a node cannot be reached or `out` cannot be
    used. What goes wrong later ends the run: recording and summary are kept, `error` in the summary and the exit code
    say so.
    """
    ready = profile.runnable()
    check_extras(ready)
    directory.check_writable(out)
    seeds = Seeds(ready.clock.seed)
    scenery = Scenery(ready)
    for text in warnings:
        scenery.warn(text)
    plant = build_plant([ready], seeds, scenery)
    interruption = Interruption()
    with ExitStack() as opened:
        stations = StationAddresses(ready)
        opened.callback(stations.close)
        setup = RunSetup(ready, seeds, scenery, plant, out, make_view, interruption, stations)
        vessels = [compose(setup, opened)]
        for vessel in vessels:
            for node in vessel.nodes:
                node.prepare()
        directory.create(out, overwrite)
        with directory.reserve(out), interruption.noticed():
            directory.write_profile(out, resolved_yaml(profile))
            recorder = Recorder(out / directory.RECORDING, ready.recording.compression, link_names(ready))
            pace: Pace = Lockstep() if ready.clock.mode == "lockstep" else Realtime(plant.simulation.dt_s)
            outcome = replace(_go(profile, setup, vessels, pace, recorder), timed=timed)
    for vessel in vessels:
        for node in vessel.nodes:
            node.save(out)
    summary = summary_of(ready, outcome, {vessel.name: _sections(vessel, setup, pace) for vessel in vessels})
    directory.write_json(out / directory.SUMMARY, summary)
    if outcome.crash is not None:
        raise outcome.crash
    return Result(summary, out, _exit_code(outcome))


def check_extras(profile: RunProfile) -> None:
    """Raise UserError when packages are missing that its perception needs: before anything is made, and not after."""
    sensors, companion = profile.sensors, profile.companion
    wanted = {"embreex": [f"sensors.{key}" for key in ("lidar", "sonar") if getattr(sensors, key, None) is not None]}
    if companion is not None and companion.runs != "board":
        wanted["kiss_icp"] = ["companion"]
    missing = [package for package in PERCEPTION.missing if wanted.get(package)]
    if missing:
        keys = [key for package in missing for key in wanted[package]]
        raise UserError(
            f"{profile.name}: {', '.join(keys)}: cannot do without {' and '.join(missing)}, not installed here; "
            f"{PERCEPTION.pip_line}"
        )


def _go(
    profile: Profile, setup: RunSetup, vessels: Sequence[VesselNodes], pace: Pace, recorder: Recorder
) -> RunOutcome:
    """Begin, loop, end, whatever happens."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    clock, plant = SimulationClock(pace), setup.plant
    loop = Loop(setup.profile.clock, plant, vessels, pace, clock, recorder, setup.interrupted)
    ending = Ending.FAILED
    error: str | None = None
    crash: Exception | None = None
    begun_s = time.perf_counter()
    try:
        try:
            _write_head(recorder, profile, setup, started)
            for vessel in vessels:
                for node in vessel.nodes:
                    node.begin(RunContext(recorder, pace, clock, vessel.name))
            begun_s = time.perf_counter()
            ending = loop.run()
        finally:
            wall_s = time.perf_counter() - begun_s
            try:
                for vessel in vessels:
                    for node in vessel.nodes:
                        node.end()
            finally:
                recorder.close()
    except StoppedWaitingError:
        ending = Ending.INTERRUPTED
    except UserError as problem:
        ending, error = Ending.FAILED, str(problem)
    except Exception as fault:  # noqa: BLE001  raised again when the summary is written: no recording is left without one
        ending, error, crash = Ending.FAILED, f"fault of xitl: {fault!r}", fault
    return RunOutcome(
        ending=ending,
        error=error,
        crash=crash,
        started_utc=started,
        duration_s=plant.state.time_ns * 1e-9,
        wall_s=wall_s,
        completed=loop.completed,
        held_s=plant.vessels[0].held_s,
    )


def _sections(vessel: VesselNodes, setup: RunSetup, pace: Pace) -> Sections:
    """What the host and a vessel's nodes report. Agents' clocks are measured against the host's, which comes last."""
    rate_hz = setup.profile.clock.physics_rate_hz
    host = {"tasks": [pace.task(rate_hz)], "pace": pace.report(), "warnings": setup.warnings}
    sections = merged([host, *(node.report() for node in vessel.nodes)])
    if sections["clocks"]:
        slope = pace.slope(rate_hz)
        physics = ClockReport("PS1", 0.0, 0.0, 0.0, slope_s=slope.mean_s, slope_std_s=slope.deviation_s)
        sections["clocks"].append(physics)
    return sections


def _write_head(recorder: Recorder, profile: Profile, setup: RunSetup, started: str) -> None:
    """What a reader needs to understand the rest: the profile, the dialect of the raw frames, the scene."""
    ready = setup.profile
    recorder.metadata(
        "xitl", {"version": __version__, "profile": profile.name, "seed": str(ready.clock.seed), "started_utc": started}
    )
    recorder.attach(directory.PROFILE, "application/yaml", resolved_yaml(profile).encode())
    recorder.attach("xitl.xml", "application/xml", files("agent.wire").joinpath("xitl.xml").read_bytes())
    if ready.recording.scene:
        recorder.scene(make_scene(ready, setup.scenery))


def _exit_code(outcome: RunOutcome) -> int:
    if outcome.error is not None:
        return USER_ERROR
    if outcome.ending is Ending.INTERRUPTED:
        return INTERRUPTED
    wanted = outcome.completed or (outcome.timed and outcome.ending is Ending.DURATION)
    return COMPLETED if wanted else INCOMPLETE


class Interruption:
    """Whether somebody wants to end the run: True once `noticed` has seen Ctrl-C, SIGTERM or a terminal hung up."""

    def __init__(self) -> None:
        self._seen = False

    def __call__(self) -> bool:
        return self._seen

    @contextmanager
    def noticed(self) -> Iterator[None]:
        """Each ends the run at the next exchange instead of anywhere; a second Ctrl-C acts as usual.

        Python delivers signals to the main thread alone: a run in another thread is not interrupted by them. A SIGHUP
        that is ignored already, as under `nohup`, stays so.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: FrameType | None) -> None:
            if self._seen and number == signal.SIGINT:
                raise KeyboardInterrupt
            self._seen = True

        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            numbers.append(signal.SIGHUP)
        previous = {number: signal.signal(number, note) for number in numbers}
        try:
            yield
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)
