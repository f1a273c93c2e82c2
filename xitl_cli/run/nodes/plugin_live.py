"""Live outputs by the names in the profile. Those of other packages are guarded: a failure names the package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from agent.entry_points import OWN_PACKAGE
from xitl_cli.plugin import LiveOutputKind
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.mcap_file import ChannelMirror
from xitl_cli.registry import LIVE_OUTPUTS, load, package_of
from xitl_cli.run.core.live_output import LiveOutput, LiveRun, LiveVessel
from xitl_cli.run.core.node import RunNode, RunStep
from xitl_cli.run.core.plugin_error import PluginNodeError
from xitl_cli.run.nodes.plugin_nodes import PluginGuard, PluginNode


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
