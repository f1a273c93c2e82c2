"""Declarations of nodes, and their resolution: which nodes a run has, how each is made, and when it is called.

A declaration is the function that makes a node. The types of its parameters are its needs. Its return type is what it
provides to others:

    @part(Place.LINKS, when=VesselSetup.has_autopilot)
    def links(setup: VesselSetup, autopilot: AutopilotNode, companion: CompanionNode | None) -> LinkRecorder: ...

`CompanionNode | None` is an optional need. A function that returns None adds no node to this run.

Classes are matched by their names, so that a declaration of a node that a run does not have imports nothing.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import field
from enum import IntEnum, auto
from typing import Any, TypeVar

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Edge
from xitl_cli.run.core.node import RunNode

T = TypeVar("T")


class CompositionError(UserError):
    """The declarations of a run do not fit together. The message names both sides."""


class Place(IntEnum):
    """Order of the calls in a step. The nodes of the world come first and last, those of each vessel in between."""

    DISPLAY = auto()
    OPERATOR = auto()
    RIVER = auto()
    COLLISIONS = auto()
    AIS_RECEIVER = auto()
    SENSORS = auto()
    PERCEPTION = auto()
    FINDINGS = auto()
    DRIVER = auto()
    FAULTS = auto()
    COMPANION_INTAKE = auto()
    TICK = auto()
    CONTROL = auto()
    """The node that moves the vessel. Nodes of an earlier place are called for all vessels before any of these waits
    for an answer."""
    AUTOPILOT_EVENTS = auto()
    BRIDGE = auto()
    COMPANION = auto()
    ESTIMATE_RATE = auto()
    LINKS = auto()
    ROS_COMPANION = auto()
    COMMANDS = auto()
    MODEL_RANGE = auto()
    MISSION = auto()
    PLUGINS = auto()
    TRACK = auto()
    LIVE_VESSEL = auto()
    TRUTH = auto()
    SCRIPTED_VESSELS = auto()
    AIS = auto()
    ENCOUNTERS = auto()
    TIDE = auto()
    LAUNCHING = auto()
    PACE = auto()
    SHOWING = auto()
    STATIONS = auto()
    LIVE = auto()


@dataclass(frozen=True, slots=True)
class Need:
    """An argument of a declaration."""

    argument: str
    kind: str
    """Name of the class."""
    optional: bool = False
    """None is passed when no node of this run provides it."""


@dataclass(frozen=True, slots=True)
class Part:
    """The declaration of one node kind, or of an object that several nodes need."""

    name: str
    make: Callable[..., Any]
    needs: tuple[Need, ...] = ()
    provides: tuple[str, ...] = ()
    """Names of classes."""
    place: Place | None = None
    """Place in the step; None for an object that is not a node."""
    when: Callable[[Any], bool] = lambda setup: True
    """Whether a run with this setup has it."""
    also_at: Mapping[Place, str] = field(default_factory=dict)
    """Attributes of the node that are nodes at other places."""
    edges: tuple[Edge, ...] = ()
    """Links of the run's graph inside this machine that exist when the run has the node. Links to agents are measured:
    see `xitl_cli.graph.graph`."""


def part(
    place: Place | None = None,
    when: Callable[[Any], bool] = lambda setup: True,
    provides: tuple[str, ...] = (),
    also_at: Mapping[Place, str] | None = None,
    edges: tuple[Edge, ...] = (),
) -> Callable[[Callable[..., Any]], Part]:
    """Declare the decorated function as a part. provides: names of its other interfaces."""

    def declare(make: Callable[..., Any]) -> Part:
        needs, returned = _signature(make)
        name = make.__name__.replace("_", " ")
        return Part(name, make, needs, (*returned, *provides), place, when, also_at or {}, edges)

    return declare


@dataclass(frozen=True, slots=True)
class Parts:
    """Everything that was made for a vessel, or for the world, by type."""

    _made: Mapping[str, Any]
    _placed: Sequence[tuple[Place, RunNode]]
    edges: tuple[Edge, ...] = ()
    """Links of the run's graph that the parts declare."""

    def get(self, kind: type[T]) -> T | None:
        """Return the object of this type, None when there is none."""
        return self._made.get(kind.__name__)

    def need(self, kind: type[T]) -> T:
        """Return the object of this type. Raises CompositionError when there is none."""
        made = self.get(kind)
        if made is None:
            raise CompositionError(f"no node of this run provides {kind.__name__}")
        return made

    def nodes(self, after: Place | None = None, before: Place | None = None) -> tuple[RunNode, ...]:
        """Return the nodes in the order of the calls, those between two places alone if given."""
        ordered = sorted(self._placed, key=lambda placed: placed[0])
        return tuple(
            node for place, node in ordered if (after is None or place > after) and (before is None or place < before)
        )


def made_parts(declared: Sequence[Part], given: Mapping[type, Any], setup: object, opened: ExitStack) -> Parts:
    """Make the parts that a run with this setup has, in the order of the list; `opened` closes them.

    given: objects that exist already, by type. A part that others need is made before them. Raises CompositionError
    for two providers of a type, a missing need and needs in a circle, and UserError for what a node refuses.
    """
    wanted = [declaration for declaration in declared if declaration.when(setup)]
    made: dict[str, Any] = {kind.__name__: instance for kind, instance in given.items()}
    providers: dict[str, Part] = {}
    for declaration in wanted:
        for kind in declaration.provides:
            if kind in made or kind in providers:
                other = providers[kind].name if kind in providers else "the run itself"
                raise CompositionError(f"{declaration.name} and {other} both provide {kind}; leave one out")
            providers[kind] = declaration
    placed: list[tuple[Place, RunNode]] = []
    edges: list[Edge] = []
    begun: list[Part] = []
    done: list[Part] = []

    def make(declaration: Part) -> None:
        if declaration in done:
            return
        if declaration in begun:
            circle = " → ".join(link.name for link in (*begun[begun.index(declaration) :], declaration))
            raise CompositionError(f"nodes need each other in a circle: {circle}")
        begun.append(declaration)
        arguments = {}
        for need in declaration.needs:
            if need.kind in providers:
                make(providers[need.kind])
            argument = made.get(need.kind)
            if argument is None and not need.optional:
                raise CompositionError(f"{declaration.name} needs {need.kind}, which no node of this run provides")
            arguments[need.argument] = argument
        node = declaration.make(**arguments)
        begun.remove(declaration)
        done.append(declaration)
        if node is None:
            return
        opened.callback(getattr(node, "close", lambda: None))
        made.update(dict.fromkeys(declaration.provides, node))
        edges.extend(declaration.edges)
        if declaration.place is not None:
            placed.append((declaration.place, node))
        for place, name in declaration.also_at.items():
            placed.append((place, getattr(node, name)))
            opened.callback(placed[-1][1].close)

    for declaration in wanted:
        make(declaration)
    return Parts(made, placed, tuple(edges))


def _signature(make: Callable[..., Any]) -> tuple[tuple[Need, ...], tuple[str, ...]]:
    """Return the needs of a function, and the names of the classes that it provides, by the text of its annotations."""
    returned = tuple(_class_names(make.__annotations__["return"]))
    needs = []
    for name in inspect.signature(make).parameters:
        annotation = make.__annotations__[name]
        needs.append(Need(name, _class_names(annotation)[0], optional=annotation.endswith("| None")))
    return tuple(needs), returned


def _class_names(annotation: str) -> list[str]:
    """Return the names in the text of a union, without None."""
    return [name for name in annotation.split(" | ") if name != "None"]
