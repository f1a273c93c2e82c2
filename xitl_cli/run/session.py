"""A run from profile to summary: reach the pilot, open the directory, fly, close everything whatever happens."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import Any

from agent import __version__
from xitl_cli.errors import UserError
from xitl_cli.profile import Profile, resolved_yaml
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.replay.motor_schedule import schedule_from_file, schedule_from_script
from xitl_cli.run import directory
from xitl_cli.run.links.connection import StoppedWaitingError
from xitl_cli.run.links.peer import options_of
from xitl_cli.run.loop import Ending, Loop
from xitl_cli.run.nodes.agent_pilot import AgentPilot, links_of
from xitl_cli.run.nodes.bridge import Attended
from xitl_cli.run.nodes.companion import NoCompanion
from xitl_cli.run.nodes.direct_control import IdealPilot, TrackPilot
from xitl_cli.run.nodes.findings import findings_of, sections, write
from xitl_cli.run.nodes.score import MissionScore
from xitl_cli.run.pace import Lockstep, Pace, Realtime
from xitl_cli.run.pilot import Pilot
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensors.perception import perception_of
from xitl_cli.run.summary import Outcome, summary_of
from xitl_cli.run.view import View
from xitl_cli.run.world.launches import river_of
from xitl_cli.run.world.scene import scene_of
from xitl_cli.run.world.scenery import Scenery, scenery_of
from xitl_cli.run.world.world import build

COMPLETED, INCOMPLETE, USER_ERROR, INTERRUPTED = 0, 1, 2, 130


@dataclass(frozen=True, slots=True)
class Result:
    """What the command needs to say how it went."""

    summary: dict[str, Any]
    directory: Path
    exit_code: int


def run(profile: Profile, out: Path, overwrite: bool, make_view: Callable[[], View]) -> Result:
    """One run, kept in `out`.

    Raises UserError, leaving nothing behind, when the profile cannot run, the pilot cannot be reached or `out` cannot
    be used. What goes wrong later ends the run: recording and summary are kept, `error` in the summary and the exit
    code say so.
    """
    ready = profile.runnable()
    directory.check_writable(out)
    seeds = Seeds(ready.clock.seed)
    scenery = scenery_of(ready)
    simulation, state = build(ready, seeds, scenery)
    pilot = make_pilot(ready, seeds, out)
    companion = pilot.companion if isinstance(pilot, AgentPilot) else NoCompanion()
    with (
        closing(pilot),
        closing(river_of(ready, seeds, simulation)) as river,
        closing(perception_of(ready, seeds, scenery, simulation, companion.send)) as perception,
    ):
        pilot.prepare()
        directory.create(out, overwrite)
        with directory.reserve(out):
            directory.write_profile(out, resolved_yaml(profile))
            recorder = Recorder(out / directory.RECORDING, ready.recording.compression, links_of(ready))
            pace: Pace = Lockstep() if ready.clock.mode == "lockstep" else Realtime(simulation.dt_s)
            with closing(make_view()) as view, _interrupts() as interrupted:
                if isinstance(pilot, AgentPilot):
                    pilot.interrupted = interrupted
                score = MissionScore(ready.mission.waypoints_ned_m)
                findings = findings_of(ready, scenery, companion)
                loop = Loop(
                    ready,
                    simulation,
                    state,
                    pilot,
                    pace,
                    recorder,
                    view,
                    score,
                    interrupted,
                    river,
                    perception,
                    findings,
                )
                outcome = _fly(loop, profile, seeds, scenery)
    directory.keep_dataflash(out)
    summary = summary_of(ready, outcome) | sections(findings, scenery.boom, companion)
    summary["warnings"] = list(scenery.warnings)
    write(findings, out)
    directory.write_json(out / directory.SUMMARY, summary)
    if outcome.crash is not None:
        raise outcome.crash
    return Result(summary, out, _exit_code(outcome))


def _fly(loop: Loop, profile: Profile, seeds: Seeds, scenery: Scenery) -> Outcome:
    started = datetime.now(UTC).isoformat(timespec="seconds")
    ending = Ending.FAILED
    error: str | None = None
    crash: Exception | None = None
    begun_s = time.perf_counter()
    try:
        try:
            _write_head(loop.recorder, profile, loop.profile, scenery, started)
            for text in scenery.warnings:
                loop.view.warn(text)
            loop.river.begin(loop.recorder)
            loop.perception.begin(loop.recorder)
            loop.findings.begin(loop.recorder, lambda: loop.state.time_ns)
            loop.pilot.begin(loop.recorder, loop.pace)
            begun_s = time.perf_counter()
            ending = loop.run(seeds)
        finally:
            wall_s = time.perf_counter() - begun_s
            try:
                loop.pilot.end()
            finally:
                loop.recorder.close()
    except StoppedWaitingError:
        ending = Ending.INTERRUPTED
    except UserError as problem:
        ending, error = Ending.FAILED, str(problem)
    except Exception as fault:  # noqa: BLE001  raised again when the summary is written: no recording is left without one
        ending, error, crash = Ending.FAILED, f"fault of xitl: {fault!r}", fault
    return Outcome(
        ending=ending,
        error=error,
        crash=crash,
        started_utc=started,
        duration_s=loop.state.time_ns * 1e-9,
        wall_s=wall_s,
        mission=loop.score,
        completed=loop.completed,
        moored_s=loop.moored_steps * loop.simulation.dt_s,
        estimation=loop.pilot.estimation,
        links=loop.pilot.links(),
        tasks=[loop.pace.task(loop.profile.clock.physics_rate_hz), *loop.pilot.tasks()],
        clocks=loop.pilot.clocks(),
        nodes=loop.pilot.nodes(),
        stale_exchanges=loop.pilot.stale_exchanges,
        actuators=loop.pilot.actuators(),
        takeovers=loop.pilot.takeovers(),
        faults=loop.pilot.faults(),
        traffic=loop.pilot.traffic(),
        pace=loop.pace.report(),
        autopilot=loop.pilot.autopilot(),
        collisions=loop.river.collisions(),
        debris=loop.river.debris(),
        perception=loop.perception.report(),
    )


def make_pilot(profile: RunProfile, seeds: Seeds, out: Path | None = None) -> Pilot:
    """Who steers in this profile. `out` is where an autopilot's own log goes. Raises UserError for a file to replay."""
    if profile.autopilot.kind == "embedded":
        return AgentPilot(profile, seeds, options_of(profile, out))
    if profile.autopilot.kind != "none":
        attended = Attended(profile, out)
        return AgentPilot(profile, seeds, options_of(profile, out, attended.bridge), attended)
    driver, propellers = profile.driver, profile.vehicle.commands
    if driver.kind == "script":
        return TrackPilot(schedule_from_script(driver.script), "SCRIPT", propellers)
    if driver.kind == "replay":
        assert driver.file is not None
        return TrackPilot(schedule_from_file(driver.file, driver.replay, propellers), "REPLAY", propellers)
    return IdealPilot(profile)


def _write_head(recorder: Recorder, profile: Profile, ready: RunProfile, scenery: Scenery, started: str) -> None:
    """What a reader needs to understand the rest: the profile, the dialect of the raw frames, the scene."""
    recorder.metadata(
        "xitl", {"version": __version__, "profile": profile.name, "seed": str(ready.clock.seed), "started_utc": started}
    )
    recorder.attach(directory.PROFILE, "application/yaml", resolved_yaml(profile).encode())
    recorder.attach("xitl.xml", "application/xml", files("agent.wire").joinpath("xitl.xml").read_bytes())
    if ready.recording.scene:
        recorder.scene(scene_of(ready, scenery))


def _exit_code(outcome: Outcome) -> int:
    if outcome.error is not None:
        return USER_ERROR
    if outcome.ending is Ending.INTERRUPTED:
        return INTERRUPTED
    return COMPLETED if outcome.completed else INCOMPLETE


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM end the run at the next exchange instead of anywhere; a second Ctrl-C acts as usual."""
    seen: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if seen and number == signal.SIGINT:
            raise KeyboardInterrupt
        seen.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(seen)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
