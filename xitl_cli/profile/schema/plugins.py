"""`plugins`: the keys of nodes that other packages bring, by the name of the plug-in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from typing import Any

from sim_core.vessel.actuators import ActuatorSpec
from xitl_cli.registry import DRIVERS, LIVE_OUTPUTS, NODES, PluginError, load, names, package_of


@dataclass(frozen=True, slots=True)
class GroupsByName:
    """Marks a key that holds groups whose class depends on the name of the group.

    group: the class of a name. It raises UserError, whose sentence begins with the name, for a name without a class.
    """

    group: Callable[[str], type]


def plugin_keys(name: str) -> type[Any]:
    """The keys of a plug-in's node, driver or live output. Raises PluginError when it is missing or cannot be used."""
    if name not in names(NODES):
        for registry, what in ((DRIVERS, "driver"), (LIVE_OUTPUTS, "live output")):
            if name in names(registry):
                return _optional_keys(registry, what, name)
    kind = load(NODES, name)
    if not (hasattr(kind, "keys") and hasattr(kind, "make") and hasattr(kind, "topics")):
        problem = f"registers {type(kind).__name__} in {NODES}, which is not xitl_cli.plugin.NodeKind"
    elif not (isinstance(kind.keys, type) and is_dataclass(kind.keys)):
        problem = f"has a NodeKind whose keys are not a dataclass: {kind.keys!r}"
    else:
        return kind.keys
    raise PluginError(f"{name}: the plug-in of {package_of(NODES, name)} {problem}; correct it")


def registered_keys(registry: str, name: str, kind: str) -> type[Any]:
    """The keys of `kind`, which a package registers in the group `registry` for `vehicle.actuators.NAME`.

    Raises PluginError when the package is missing or cannot be used.
    """
    keys = load(registry, kind)
    if isinstance(keys, type) and issubclass(keys, ActuatorSpec) and is_dataclass(keys):
        return keys
    shown = keys.__name__ if isinstance(keys, type) else type(keys).__name__
    raise PluginError(
        f"{kind}: the plug-in of {package_of(registry, kind)} registers {shown} in {registry}, which is not a "
        "dataclass that derives from sim_core.vessel.actuators.ActuatorSpec; correct it"
    )


def _optional_keys(registry: str, what: str, name: str) -> type[Any]:
    keys = getattr(load(registry, name), "keys", None)
    if isinstance(keys, type) and is_dataclass(keys):
        return keys
    raise PluginError(f"{name}: the {what} of {package_of(registry, name)} has no keys; leave the group out")
