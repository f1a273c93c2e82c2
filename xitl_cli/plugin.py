"""Declarations that plug-ins register under the entry-point groups of `registry.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import typer
    from numpy.random import Generator
    from typer.core import TyperGroup

    from xitl_cli.profile.schema import RunProfile
    from xitl_cli.record.topics import Topic
    from xitl_cli.run.composition.parts import Place
    from xitl_cli.run.core.node import ControlNode, RunNode
    from xitl_cli.run.world.plant import PlantView
    from xitl_cli.scenery import Scenery
    from xitl_cli.seeds import Seeds

__all__ = ["Command", "NodeContext", "NodeKind"]


@dataclass(frozen=True, slots=True)
class Command:
    """A command of `xitl`, or a group of commands, under the name of its entry point (group `xitl.commands`)."""

    help: str
    """One sentence, for `xitl --help`. Of a single command it is the first sentence of the function's docstring."""

    add: Callable[[typer.Typer, str], None]
    """`add(app, name)` registers the functions. xitl calls it only when the command is on the command line, so that
    imports inside of it cost nothing elsewhere. A single command registers itself as `name` in `app`. The commands of a
    group register in `app`, which is the group."""

    group: bool = False
    """Whether it is a group of commands."""

    group_class: Callable[[], type[TyperGroup]] | None = None
    """Makes the click class of a group, None for the usual one."""

    help_without_command: bool = True
    """Whether a group shows its help when no command follows."""


@dataclass(frozen=True, slots=True)
class NodeContext:
    """The vessel and the world of a node of a plug-in. Frames are NED and FRD, as everywhere inside xitl."""

    name: str
    """Name of the plug-in: the key below `plugins` of the profile."""

    profile: RunProfile
    """Profile of the vessel; `profile.vessel` is its name, empty where there is one vessel."""

    plant: PlantView
    """The world as this vessel meets it. `state` and `motion()` are of the latest physics step."""

    scenery: Scenery
    """Objects that do not move: bed, banks, log boom, dam, buildings."""

    control: ControlNode
    """The node whose motor commands move the vessel: `command`, `progress`."""

    seeds: Seeds
    """Seeds of the vessel, for a node that needs several independent streams."""

    rng: Generator
    """Random generator of this node. It depends on `clock.seed`, the vessel and the name of the plug-in alone."""

    parts: Mapping[type, Any] = field(default_factory=dict)
    """The objects that `NodeKind.needs` asks for, by type."""


@dataclass(frozen=True, slots=True)
class NodeKind:
    """A kind of node of a run, under the name of its entry point (group `xitl.nodes`).

    A vessel has the node when its profile has the group `plugins.NAME`.
    """

    keys: type
    """Keys of the profile below `plugins.NAME`: a frozen dataclass that derives from `sim_core.keys.Specification`."""

    make: Callable[[Any, NodeContext], RunNode]
    """`make(keys, context)` returns the node of one vessel. Raises UserError when the run cannot have it."""

    topics: Sequence[Topic] = ()
    """Topics that the node records. With several vessels, the vessel's name is in front of each name."""

    needs: Sequence[type] = ()
    """Other nodes of the vessel that `make` finds in `NodeContext.parts`, such as `AutopilotNode`. A run without one of
    them is refused."""

    place: Place | None = None
    """Place of the node in a step, None for the usual one: after the mission's score, before the live outputs."""


def keep_group(app: typer.Typer) -> None:
    """Keep a group with one command a group: typer would turn it into the command itself."""

    def several() -> None:
        """Keeps the name of the only command."""

    app.callback()(several)
