"""Drivers by the name in the profile. A driver of another package is guarded, so that a failure names the package."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from agent.entry_points import OWN_PACKAGE
from xitl_cli.plugin import DriverContext, DriverKind
from xitl_cli.registry import DRIVERS, load, package_of
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.plugin_error import PluginNodeError
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.plugin_nodes import PluginGuard


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
