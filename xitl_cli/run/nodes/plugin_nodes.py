"""Nodes, drivers and live outputs of plug-ins, guarded so that a failure names the plug-in."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from agent.entry_points import OWN_PACKAGE
from agent.wire.dialect import MAV_SEVERITY_ERROR as ERROR
from agent.wire.link import Link
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.mcap_file import ChannelMirror
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import Topic
from xitl_cli.registry import DRIVERS, LIVE_OUTPUTS, NODES, failure_text, load, package_of
from xitl_cli.run.core.live_output import LiveOutput, LiveRun, LiveVessel
from xitl_cli.run.core.node import PluginNodeError, RunContext, RunNode, RunStep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run_kinds import DriverContext, DriverKind, LiveOutputKind

P = ParamSpec("P")
T = TypeVar("T")


class PluginGuard:
    """Calls the code of a plug-in. who: names the plug-in, `plugins.NAME (package version)`.

    An exception of the plug-in becomes PluginNodeError, and its traceback goes into the recording. A UserError of the
    plug-in is passed on. Failures after the run are warnings of the summary.
    """

    def __init__(self, name: str, who: str) -> None:
        self.now_ns = 0
        self.failed = False
        self.recorder: Recorder | None = None
        self.warnings: list[str] = []
        self._name = name
        self._who = who

    def call(self, when: str, call: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T:
        """Return the result of the call. Raises PluginNodeError for an exception of the plug-in."""
        try:
            return call(*arguments, **keywords)
        except UserError:
            self.failed = True
            raise
        except Exception as problem:
            self.failed = True
            if self.recorder is not None:
                text = "".join(traceback.format_exception(problem))
                self.recorder.log(self.now_ns, ERROR, self._name, text)
            raise PluginNodeError(self._sentence(when or f"at {self.now_ns * 1e-9:.2f} s", problem)) from problem

    def after_the_run(self, when: str, call: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T | None:
        """Return the result of the call, None when it fails; the failure is a warning."""
        try:
            return call(*arguments, **keywords)
        except Exception as problem:  # noqa: BLE001  the run is over, and its summary keeps this
            self.warnings.append(self._sentence(when, problem))
            return None

    def _sentence(self, when: str, problem: Exception) -> str:
        return f"{self._who} failed {when} ({failure_text(problem)}); correct the plug-in or remove it from the profile"


class PluginNode(RunNode):
    """The node of a plug-in.

    After an exception of the plug-in, the node is not called again, except to close it. who: as for PluginGuard, which
    has the default for a node of the profile's `plugins`.
    """

    def __init__(self, name: str, make: Callable[[], Any], topics: Sequence[Topic] = (), who: str = "") -> None:
        who = who or f"plugins.{name} ({package_of(NODES, name)})"
        self._name = name
        self._topics = topics
        self._guard = PluginGuard(f"plugins.{name}", who)
        node = self._guard.call("when it was made", make)
        if not isinstance(node, RunNode):
            raise PluginNodeError(
                f"{who}: its make returned {type(node).__name__}, which is not a RunNode; correct the plug-in"
            )
        self._node = node

    def prepare(self) -> None:
        self._guard.call("before the run", self._node.prepare)

    def begin(self, context: RunContext) -> None:
        self._guard.recorder = context.recorder
        for topic in self._topics:
            context.recorder.add_topic(topic)
        self._guard.call("at the start", self._node.begin, context)
        self.sense_every, self.record_every = self._node.sense_every, self._node.record_every

    def touch(self, step: RunStep) -> None:
        self._guard.now_ns = step.now_ns
        self._guard.call("", self._node.touch, step)

    def sense(self, step: RunStep) -> None:
        self._guard.now_ns = step.now_ns
        self._guard.call("", self._node.sense, step)

    def exchange(self, step: RunStep) -> None:
        self._guard.now_ns = step.now_ns
        self._guard.call("", self._node.exchange, step)

    def record(self, step: RunStep) -> None:
        if not self._guard.failed:
            self._guard.now_ns = step.now_ns
            self._guard.call("", self._node.record, step)

    def links(self) -> Sequence[Link]:
        return self._guard.call("", self._node.links)

    def receive(self, timeout_s: float) -> None:
        self._guard.call("", self._node.receive, timeout_s)

    def end(self) -> None:
        if not self._guard.failed:
            self._guard.call("at the end", self._node.end)

    def close(self) -> None:
        self._guard.after_the_run("when it was closed", self._node.close)

    def save(self, folder: Path) -> None:
        if not self._guard.failed:
            self._guard.after_the_run("when it saved its files", self._node.save, folder)

    def report(self) -> dict[str, Any]:
        """plugins: the report of each plug-in's node by name."""

        def report() -> Any:
            return json.loads(json.dumps(self._node.report(), allow_nan=False))

        section = None if self._guard.failed else self._guard.after_the_run("in its report", report)
        return {"plugins": {self._name: section}, "warnings": list(self._guard.warnings)}


def driver_of(context: DriverContext) -> VehicleDriver:
    """Return the driver that the profile selects.

    Raises PluginError when no package has it, and UserError when the run cannot have it.
    """
    name = context.profile.driver.kind
    kind: DriverKind = load(DRIVERS, name)
    if context.keys is None and kind.keys is not None:
        context = replace(context, keys=kind.keys())
    package = package_of(DRIVERS, name)
    if package.split()[0] == OWN_PACKAGE:
        driver: VehicleDriver = kind.make(context)
        return driver
    return PluginDriver(name, f"driver.kind {name} ({package})", kind, context)


class PluginDriver(VehicleDriver):
    """The driver of another package. After an exception it is not called again, except to close it."""

    def __init__(self, name: str, who: str, kind: DriverKind, context: DriverContext) -> None:
        guard = self._guard = PluginGuard(name, who)
        driver = guard.call("when it was made", kind.make, context)
        if not isinstance(driver, VehicleDriver):
            raise PluginNodeError(
                f"{who}: its make returned {type(driver).__name__}, which is not a VehicleDriver; correct the plug-in"
            )
        self._driver = driver

    def prepare(self) -> None:
        self._guard.call("before the run", self._driver.prepare)

    def begin(self, context: RunContext) -> None:
        self._guard.recorder = context.recorder
        self._guard.call("at the start", self._driver.begin, context)

    def update(self, sim_ns: int) -> None:
        self._guard.now_ns = sim_ns
        self._guard.call("", self._driver.update, sim_ns)

    def handle(self, message: Any) -> None:
        self._guard.call("", self._driver.handle, message)

    @property
    def ready(self) -> bool:
        return self._guard.call("", lambda: bool(self._driver.ready))

    @property
    def departed(self) -> bool:
        return self._guard.call("", lambda: bool(self._driver.departed))

    def finish(self) -> None:
        self._guard.call("", self._driver.finish)

    def progress(self) -> Progress:
        return self._guard.call("", self._driver.progress)

    def end(self) -> None:
        if not self._guard.failed:
            self._guard.call("at the end", self._driver.end)

    def close(self) -> None:
        self._guard.after_the_run("when it was closed", self._driver.close)

    def save(self, folder: Path) -> None:
        if not self._guard.failed:
            self._guard.after_the_run("when it saved its files", self._driver.save, folder)

    def report(self) -> dict[str, Any]:
        report = None if self._guard.failed else self._guard.after_the_run("in its report", self._driver.report)
        return {**(report or {}), "warnings": list(self._guard.warnings)}


def live_outputs(profiles: Sequence[RunProfile]) -> list[LiveOutput]:
    """Load the live outputs that the first profile of a run selects.

    Raises PluginError when one is missing, and UserError when the run cannot have it.
    """
    lead = profiles[0]
    wanted = {"view": lead.view.show, "foxglove": lead.live.streams_foxglove, "ros": lead.ros.enabled}
    names = [name for name, is_wanted in wanted.items() if is_wanted]
    return [_live_output(name, profiles) for name in dict.fromkeys((*names, *lead.live.outputs))]


def _live_output(name: str, profiles: Sequence[RunProfile]) -> LiveOutput:
    kind, package = load(LIVE_OUTPUTS, name), package_of(LIVE_OUTPUTS, name)

    def make() -> Any:
        if not isinstance(kind, LiveOutputKind):
            return kind(profiles)
        keys = profiles[0].plugins.get(name)
        return kind.make(profiles, kind.keys() if keys is None and kind.keys is not None else keys)

    if package.split()[0] == OWN_PACKAGE:
        output: LiveOutput = make()
        return output
    return PluginOutput(name, f"live.outputs {name} ({package})", make)


class PluginOutput(LiveOutput):
    """The live output of another package."""

    def __init__(self, name: str, who: str, make: Callable[[], Any]) -> None:
        self._name, self._who = name, who
        self._guard = PluginGuard(f"live.{name}", who)
        self._output = self._guard.call("when it was made", make)
        if not isinstance(self._output, LiveOutput):
            made = type(self._output).__name__
            raise PluginNodeError(f"{who}: its make returned {made}, which is not a LiveOutput; correct the plug-in")

    def vessel_node(self, vessel: LiveVessel) -> RunNode | None:
        node = self._guard.call("when its node was made", self._output.vessel_node, vessel)
        return None if node is None else self._guarded(node)

    def world_nodes(self, run: LiveRun) -> Sequence[RunNode]:
        return [self._guarded(node) for node in self._guard.call("when its nodes were made", self._made, run)]

    def _made(self, run: LiveRun) -> list[Any]:
        return list(self._output.world_nodes(run))

    def _guarded(self, node: Any) -> RunNode:
        return PluginLiveNode(self._name, lambda: node, who=self._who)


class PluginLiveNode(PluginNode):
    """A node of a live output of another package.

    An exception in its mirror ends the run at the next exchange, not in the node that writes the message.
    """

    _failure: Exception | None = None

    def attach_operator(self, operator: Any) -> None:
        self._guard.call("before the run", self._node.attach_operator, operator)

    def mirror(self) -> ChannelMirror | None:
        mirror = self._guard.call("before the run", self._node.mirror)
        return None if mirror is None else _GuardedMirror(mirror, self._fail)

    def exchange(self, step: RunStep) -> None:
        if self._failure is not None:
            self._guard.call("", self._raise)
        super().exchange(step)

    def _raise(self) -> None:
        assert self._failure is not None
        raise self._failure

    def _fail(self, problem: Exception) -> None:
        self._failure = self._failure or problem


class _GuardedMirror:
    """The mirror of a package, which is not called again after an exception."""

    def __init__(self, mirror: ChannelMirror, fail: Callable[[Exception], None]) -> None:
        self._mirror = mirror
        self._fail = fail
        self._failed = False

    def open_channel(self, *described: Any) -> Callable[[bytes, int], object] | None:
        show = self._call(self._mirror.open_channel, *described)
        return None if show is None else partial(self._call, show)

    def _call(self, call: Callable[..., Any], *arguments: Any) -> Any:
        if self._failed:
            return None
        try:
            return call(*arguments)
        except Exception as problem:  # noqa: BLE001  the code of a plug-in may raise anything
            self._failed = True
            self._fail(problem)
            return None
