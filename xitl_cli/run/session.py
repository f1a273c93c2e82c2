"""A run from profile to summary: create the nodes, connect to them, run the loop, and always close everything."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from foxglove import messages

from agent import __version__
from agent.wire.dialect import MAV_SEVERITY_ERROR as ERROR
from sim_core.dataclass import dataclass
from xitl_cli.end_signals import end_signals_handled
from xitl_cli.errors import UserError
from xitl_cli.extras import PERCEPTION
from xitl_cli.logs.model.recording_schema import RECORD, SCHEMA_KEY, SCHEMA_VERSION
from xitl_cli.profile import Profile, resolved_yaml
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.mcap_file import ChannelMirror, McapFile, SplitLimits
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.composition.parts import Parts, Place
from xitl_cli.run.composition.setup import RunSetup, VesselSetup, is_awaited
from xitl_cli.run.composition.vessel import link_names, vessel_parts
from xitl_cli.run.composition.world import world_parts
from xitl_cli.run.core import directory
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, SimulationClock, VesselNodes, WorldNodes
from xitl_cli.run.core.pace import Lockstep, OperatedLockstep, Pace, Realtime
from xitl_cli.run.core.reports import ClockReport, Ending
from xitl_cli.run.links.agent_workers import fleet_workers
from xitl_cli.run.links.connection import StoppedWaitingError
from xitl_cli.run.loop import Loop, named
from xitl_cli.run.nodes.display import StatusDisplay
from xitl_cli.run.nodes.plugin_nodes import live_outputs
from xitl_cli.run.nodes.stations import StationAddresses
from xitl_cli.run.operator.operation import UNATTENDED, Operation
from xitl_cli.run.sensors.compass import compass_warnings
from xitl_cli.run.summary import RunOutcome, VesselOutcome, fleet_summary, merged, summary_of
from xitl_cli.run.traffic.self_report import VesselVoices
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.scene import make_scene
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

if TYPE_CHECKING:
    from xitl_cli.logs.model.log import Log


COMPLETED, INCOMPLETE, USER_ERROR, INTERRUPTED = 0, 1, 2, 130


@dataclass(frozen=True, slots=True)
class Result:
    """A finished run.

    summary: the content of summary.json (docs/recording.md). directory: the directory of the run. exit_code: as for
    `xitl sim`.
    """

    summary: dict[str, Any]
    directory: Path
    exit_code: int

    @property
    def completed(self) -> bool:
        """Whether the driver completed its task: mission, script or replay."""
        done: bool = self.summary["driver"]["completed"]
        return done and self.exit_code == COMPLETED

    @property
    def verdict(self) -> dict[str, Any]:
        """`verdict` of summary.json: whether the run was completed and, in real time, kept real time, with reasons."""
        verdict: dict[str, Any] = self.summary["verdict"]
        return verdict

    @property
    def recording(self) -> Path:
        """The MCAP file with every topic; the first file of a split recording."""
        return self.directory / directory.RECORDING

    def open_log(self, vessel: str | None = None) -> Log:
        """The recording, opened for reading. vessel: one vessel of a fleet. Close it, or use it in a `with`."""
        from xitl_cli.logs import open_log

        return open_log(self.recording, vessel)


def run(
    profile: Profile,
    out: Path,
    overwrite: bool,
    make_display: Callable[[], StatusDisplay],
    timed: bool = False,
    warnings: Sequence[str] = (),
    operation: Operation = UNATTENDED,
    tell: Callable[[str], None] = lambda text: None,
) -> Result:
    """Run a profile and keep the run in `out`.

    timed: the user asked for this duration, so reaching it is success. warnings: warnings of the profile, for the
    summary. operation: who may act during the run. tell: prints a line for the user, such as the address of a view.

    Raises UserError, and leaves no files, when the profile cannot run, a node cannot be reached or `out` cannot be
    used. A later error ends the run: recording and summary are kept, and the summary and the exit code state it.
    """
    profiles = profile.run_profiles()
    lead = profiles[0]
    for of_vessel in profiles:
        check_extras(of_vessel)
    vessels = [of_vessel.vessel for of_vessel in profiles if of_vessel.vessel]
    directory.check_free(out, overwrite, vessels)  # before anything is started or joined
    seeds = Seeds(lead.clock.seed)
    scenery = Scenery(lead)
    for text in (*warnings, *compass_warnings(profiles)):
        scenery.warn(text)
    plant = build_plant(profiles, seeds, scenery)
    interruption = Interruption()
    scene = cache(partial(make_scene, profiles, scenery))
    operation = replace(operation, viewed=lead.view.show, live=lead.live.streams_foxglove, ros=lead.ros.enabled)
    check_driven(profiles, operation)
    if lead.ros.enabled and operation.pace is None:
        operation = replace(operation, pace=lead.ros.pace)
    with ExitStack() as opened:
        stations = StationAddresses(profiles)
        opened.callback(stations.close)
        workers = fleet_workers(profiles)
        if workers is not None:
            opened.callback(workers.close)
        setup = RunSetup(
            profiles=profiles,
            plant=plant,
            scenery=scenery,
            out=out,
            operation=operation,
            stations=stations,
            voices=VesselVoices(),
            live=live_outputs(profiles),
            workers=workers,
            make_display=make_display,
            scene=lambda: scene().encode(),
            tell=tell,
            interrupted=interruption,
        )
        nodes = _compose(setup, opened)
        for name, node in nodes.named():
            with _of(name):
                node.prepare()
        directory.create(out, overwrite, vessels)
        with directory.reserve(out), interruption.noticed():
            resolved = resolved_yaml(profile)
            directory.write_profile(out, resolved)
            recorders = open_recorders(out / directory.RECORDING, profiles, nodes.mirrors)
            pace: Pace
            if lead.clock.mode == "realtime":
                pace = Realtime(plant.simulation.dt_s)
            else:
                pace = OperatedLockstep(interruption, operation.pace) if operation.paced else Lockstep()
            outcome = _execute(profile.name, resolved, profiles, scene, plant, nodes, pace, recorders, interruption)
            outcome = replace(outcome, timed=timed)
    for name, node in nodes.named():
        node.save(out / name)
    summary = _summary(profiles, outcome, nodes, pace, [*scenery.warnings, *nodes.warnings])
    directory.write_json(out / directory.SUMMARY, summary)
    if outcome.crash is not None:
        raise outcome.crash
    verdict = summary["verdict"]
    exit_code = COMPLETED if verdict["completed"] or verdict["duration_asked"] else INCOMPLETE
    if outcome.error is not None:
        exit_code = USER_ERROR
    elif outcome.ending is Ending.INTERRUPTED:
        exit_code = INTERRUPTED
    return Result(summary, out, exit_code)


def check_extras(profile: RunProfile) -> None:
    """Raise UserError when a package is missing that the perception of the profile needs. Nothing is created before."""
    sensors, companion = profile.sensors, profile.companion
    wanted = {"embreex": [f"sensors.{key}" for key in ("lidar", "sonar") if getattr(sensors, key, None) is not None]}
    if companion is not None and companion.is_ours and companion.runs != "board":
        wanted["kiss_icp"] = ["companion"]
    missing = [package for package in PERCEPTION.missing if wanted.get(package)]
    if missing:
        keys = [key for package in missing for key in wanted[package]]
        raise UserError(
            f"{profile.name}: {', '.join(keys)}: {' and '.join(missing)} must be installed; {PERCEPTION.pip_line}"
        )


def check_driven(profiles: Sequence[RunProfile], operation: Operation) -> None:
    """Raise UserError when the driver is ROS and neither ROS nor recorded actions can drive."""
    if operation.operated:
        return
    for profile in profiles:
        if profile.driver.kind == "ros":
            raise UserError(
                f"{profile.name}: driver.kind = ros needs ROS, which is off; add --ros, or repeat the actions of an "
                "earlier run with --replay-events"
            )


@contextmanager
def _of(vessel: str) -> Iterator[None]:
    """Name this vessel in each UserError that is raised inside."""
    try:
        yield
    except UserError as error:
        raise named(vessel, error) from error


@dataclass(frozen=True, slots=True)
class RunNodes:
    """All nodes of a run."""

    world: WorldNodes
    vessels: tuple[VesselNodes, ...]
    warnings: tuple[str, ...]
    """Warnings that are known at the start."""

    @property
    def mirrors(self) -> tuple[ChannelMirror, ...]:
        """Receivers of each recorded message, next to the recording."""
        return tuple(mirror for node in self.world.behind if (mirror := node.mirror()) is not None)

    def named(self) -> Iterator[tuple[str, RunNode]]:
        """Yield each node with its vessel's name, in the order of the calls. Nodes of the world have no name."""
        yield from (("", node) for node in self.world.ahead)
        yield from ((vessel.name, node) for vessel in self.vessels for node in vessel.nodes)
        yield from (("", node) for node in self.world.behind)


def _compose(setup: RunSetup, opened: ExitStack) -> RunNodes:
    """Make the nodes of a run; `opened` closes them. Raises UserError, which names the vessel of a fleet."""
    made: dict[str, Parts] = {}
    after = departs_after(setup.profiles)
    for profile, view in zip(setup.profiles, setup.plant.vessels, strict=True):
        name = profile.vessel
        with _of(name):
            seeds = Seeds(profile.clock.seed, name)
            made[name] = vessel_parts(VesselSetup(setup, profile, seeds, view, setup.out / name, after[name]), opened)
    world = world_parts(setup, made, opened)
    vessels = tuple(
        VesselNodes(profile.vessel, parts.need(ControlNode), parts.nodes(), is_awaited(profile), parts.edges)
        for profile, parts in zip(setup.profiles, made.values(), strict=True)
    )
    ahead, behind = world.nodes(before=Place.COLLISIONS), world.nodes(after=Place.LIVE_VESSEL)
    return RunNodes(WorldNodes(ahead, behind), vessels, tuple(setup.stations.warnings))


def open_recorders(
    path: Path, profiles: Sequence[RunProfile], mirrors: Sequence[ChannelMirror] = ()
) -> tuple[Recorder, dict[str, Recorder]]:
    """Open the recorder of the run and one for each vessel, by name, into one file. With one vessel both are the same.

    mirrors: receivers of each recorded message.
    """
    lead = profiles[0]
    file = McapFile(path, lead.recording.compression, mirrors=mirrors, split=_split_limits(lead))
    if not lead.vessel:
        recorder = Recorder(file, links=link_names(lead))
        return recorder, {"": recorder}
    vessels = {profile.vessel: Recorder(file, links=link_names(profile), vessel=profile.vessel) for profile in profiles}
    return Recorder(file, from_start=False), vessels


def _split_limits(lead: RunProfile) -> SplitLimits | None:
    split = lead.recording.split
    if split is None or (split.size_mb is None and split.time_s is None):
        return None
    return SplitLimits(
        message_bytes=None if split.size_mb is None else round(split.size_mb * 1e6),
        time_ns=None if split.time_s is None else round(split.time_s * 1e9),
    )


def _execute(
    profile_name: str,
    profile_text: str,
    profiles: Sequence[RunProfile],
    scene: Callable[[], messages.SceneUpdate],
    plant: Plant,
    nodes: RunNodes,
    pace: Pace,
    recorders: tuple[Recorder, Mapping[str, Recorder]],
    interrupted: Callable[[], bool],
) -> RunOutcome:
    """Begin, run the loop, and end the nodes in every case. profile_text: all values of the profile, as YAML."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    recorder, of_vessels = recorders
    clock = SimulationClock(pace)
    loop = Loop(profiles[0].clock, plant, nodes.vessels, pace, clock, recorder, interrupted, nodes.world)
    ending = Ending.FAILED
    error: str | None = None
    crash: Exception | None = None
    begun_s = time.perf_counter()
    try:
        try:
            _write_head(recorder, profile_name, profile_text, profiles, scene, started)
            with pace.running():  # from before the agents start: its preparation takes some time
                for name, node in nodes.named():
                    with _of(name):
                        node.begin(RunContext(of_vessels.get(name, recorder), pace, clock, name))
                begun_s = time.perf_counter()
                ending = loop.run()
        except StoppedWaitingError:
            raise
        except Exception as problem:
            with suppress(Exception):  # it may be the recorder that failed
                recorder.log(plant.state.time_ns, ERROR, "run", _what_failed(problem))
            raise
        finally:
            wall_s = time.perf_counter() - begun_s
            try:
                for name, node in nodes.named():
                    with suppress(UserError) if name in loop.losses else _of(name):
                        node.end()
            finally:
                recorder.close()
    except StoppedWaitingError:
        ending = Ending.INTERRUPTED
    except Exception as problem:  # noqa: BLE001  a fault is raised again once there is a summary
        ending, error = Ending.FAILED, _what_failed(problem)
        crash = None if isinstance(problem, UserError) else problem
    return RunOutcome(
        ending=ending,
        error=error,
        crash=crash,
        started_utc=started,
        duration_s=plant.state.time_ns * 1e-9,
        wall_s=wall_s,
        completed=loop.completed,
        why_numpy=plant.simulation.why_numpy,
        files=recorder.files,
        vessels=tuple(
            VesselOutcome(vessel.awaited, vessel.control.progress.completed, view.held_s, loop.losses.get(vessel.name))
            for vessel, view in zip(nodes.vessels, plant.vessels, strict=True)
        ),
    )


def _what_failed(problem: Exception) -> str:
    return str(problem) if isinstance(problem, UserError) else f"fault of xitl: {problem!r}"


def _summary(
    profiles: Sequence[RunProfile], outcome: RunOutcome, nodes: RunNodes, pace: Pace, warnings: Sequence[str]
) -> dict[str, Any]:
    """Merge the reports of all nodes. The clock of the host is the last one: agents' clocks are measured against it."""
    rate_hz = profiles[0].clock.physics_rate_hz
    slope = pace.slope(rate_hz)
    physics = ClockReport("PS1", 0.0, 0.0, 0.0, slope_s=slope.mean_s, slope_std_s=slope.deviation_s)
    host = {"tasks": [pace.task(rate_hz)], "pace": pace.report(), "warnings": list(warnings)}
    of_world = [host, *(node.report() for node in (*nodes.world.ahead, *nodes.world.behind))]
    of_vessels = [[{"edges": vessel.edges}, *(node.report() for node in vessel.nodes)] for vessel in nodes.vessels]
    if not profiles[0].vessel:
        sections = merged([*of_world, *of_vessels[0]])
        sections["clocks"] += [physics] if sections["clocks"] else []
        return summary_of(profiles[0], outcome, sections)
    return fleet_summary(profiles, outcome, merged([*of_world, {"clocks": [physics]}]), list(map(merged, of_vessels)))


def _write_head(
    recorder: Recorder,
    profile_name: str,
    profile_text: str,
    profiles: Sequence[RunProfile],
    scene: Callable[[], messages.SceneUpdate],
    started: str,
) -> None:
    """Write the data that a reader needs first: profile, dialect of the raw frames, scene."""
    lead = profiles[0]
    about = {SCHEMA_KEY: str(SCHEMA_VERSION), "version": __version__, "profile": profile_name}
    about |= {"seed": str(lead.clock.seed), "started_utc": started}
    if lead.vessel:
        about["vessels"] = ", ".join(of_vessel.vessel for of_vessel in profiles)
    recorder.metadata(RECORD, about)
    recorder.attach(directory.PROFILE, "application/yaml", profile_text.encode())
    for name in ("xitl.xml", "fleet.xml") if lead.vessel else ("xitl.xml",):
        recorder.attach(name, "application/xml", files("agent.wire").joinpath(name).read_bytes())
    if lead.recording.scene:
        recorder.scene(scene())


class Interruption:
    """True after Ctrl-C, SIGTERM or a hang-up of the terminal inside `noticed`."""

    def __init__(self) -> None:
        self._seen = False

    def __call__(self) -> bool:
        return self._seen

    @contextmanager
    def noticed(self) -> Iterator[None]:
        """Let these signals end the run at its next exchange. A second Ctrl-C interrupts at once.

        Python delivers signals only to the main thread, so they do not interrupt a run in another thread.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: FrameType | None) -> None:
            if self._seen and number == signal.SIGINT:
                raise KeyboardInterrupt
            self._seen = True

        with end_signals_handled(note, signal.SIGINT):
            yield


def departs_after(profiles: Sequence[RunProfile]) -> dict[str, tuple[str, ...]]:
    """Return, by vessel, the vessels that must be ready before it sets out.

    By `driver.departs_with`, these are its followers with their followers, all others, or none.
    """
    leaders = {
        profile.vessel: profile.driver.follow.vessel
        for profile in profiles
        if profile.driver.kind == "follow" and profile.driver.follow is not None
    }

    def leads(name: str, other: str) -> bool:
        while other in leaders:
            other = leaders[other]
            if other == name:
                return True
        return False

    names = [profile.vessel for profile in profiles]
    awaited = {}
    for profile in profiles:
        own, departs_with = profile.vessel, profile.driver.departs_with
        others = [name for name in names if name != own]
        if departs_with == "followers":
            others = [name for name in others if leads(own, name)]
        awaited[own] = () if departs_with == "nobody" else tuple(others)
    return awaited
