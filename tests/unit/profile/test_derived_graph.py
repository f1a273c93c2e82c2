"""The node graph that follows from a profile, and what a profile may write of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from xitl_cli.graph.wdri import graph_from_profile, profile_wdri
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.schema.graph import NodeGraph

Write = Callable[..., Path]

EXPLICIT = ("paper/", "boards/")
"""Folders whose profiles write graphs by hand."""

AT_14660 = "autopilot.link=udp://127.0.0.1:14660"
WORLD = "autopilot.bridge.world=udp://0.0.0.0:9002"


def graph(name: str, *overrides: str) -> NodeGraph:
    found = load_profile(name, overrides).graph
    assert found is not None
    return found


def kinds(found: NodeGraph) -> dict[str, str | None]:
    return {name: node.kind for name, node in found.nodes.items()}


@pytest.mark.parametrize("name", [name for name in shipped_profiles() if not name.startswith(EXPLICIT)])
def test_profiles_that_run_write_no_links_and_no_kinds(name: str) -> None:
    entry = parse_yaml(shipped_profiles()[name].read_text(encoding="utf-8"), name)
    assert entry is not None
    written = entry.plain()
    assert isinstance(written, dict)
    group = written.get("graph", {})
    assert set(group) <= {"nodes"}
    assert all(set(node) <= {"runs_on", "does"} for node in group.get("nodes", {}).values())


def test_a_profile_of_ones_own_needs_no_graph(write: Write) -> None:
    parts = "[sites/santo-antonio, vehicles/asv-full, sensors/standard, environments/calm]"
    path = write(
        f"extends: {parts}\ntechnique: sitl\ndriver: {{kind: mission}}\nautopilot: {{kind: embedded}}\n", "my.yaml"
    )
    profile = load_profile(str(path))
    assert profile.role() == "runs"
    assert profile.graph == graph("sitl")
    assert profile_wdri(profile) == profile_wdri(load_profile("sitl"))
    assert profile.runnable().graph.reference == "paper/eq24-general-use"


def test_the_low_level_links_by_hand() -> None:
    pairs = ["D-LC", "PS1-LS", "PS1-LA", "PS1-M", "LS-LC", "LS-M", "LC-LA", "LC-M", "LA-M"]
    assert graph_from_profile(graph("sitl")).link_names() == pairs
    assert graph_from_profile(graph("mitl")).link_names() == ["D-PS1", "D-M", "PS1-M"]


def test_a_companion_brings_the_high_level() -> None:
    low, both = (set(graph_from_profile(graph(name)).link_names()) for name in ("sitl", "sitl-perception"))
    assert both - low == {
        *("PS1-HS", "LS-HC", "LC-HS", "LC-HC", "LC-HA"),
        *("HS-HC", "HC-HA", "HS-M", "HC-M", "HA-M"),
    }
    assert low < both


@pytest.mark.parametrize(
    ("name", "overrides", "kind", "runs_on"),
    [
        ("sitl", (), "virtual", "this machine"),
        (
            "sitl",
            ("autopilot.runs=process", "autopilot.link=udp://127.0.0.1:14660"),
            "virtual",
            "agent process on this machine",
        ),
        ("hitl-serial-loopback", (), "virtual", "agent process on this machine"),
        ("hitl-serial", (), "real", "beaglebone-black"),
        ("hitl-serial", ("graph.nodes.LC.runs_on=jetson",), "real", "jetson"),
        ("sitl-ardupilot", (), "virtual", "ardurover on this machine"),
        (
            "sitl-ardupilot",
            ("autopilot.firmware=external", "autopilot.bridge.mavlink=tcp://10.0.0.7:5760", WORLD),
            "virtual",
            "ardurover on 10.0.0.7",
        ),
        ("hitl-ardupilot-ahrs", (), "real", "autopilot board"),
        ("hitl-ardupilot-ahrs-loopback", (), "virtual", "ardurover on this machine"),
        ("hitl-ardupilot-linux", (), "real", "beaglebone-black"),
        ("hitl-px4", (), "real", "PX4 on the board"),
    ],
)
def test_where_the_autopilot_runs(name: str, overrides: tuple[str, ...], kind: str, runs_on: str) -> None:
    node = graph(name, *overrides).nodes["LC"]
    assert (node.kind, node.runs_on) == (kind, runs_on)


def test_a_standby_on_a_board_makes_the_autopilot_real() -> None:
    standby = "autopilot.standby={runs: board, link: 'udp://192.168.7.2:14660'}"
    found = graph("hitl-beaglebone-loopback", standby)
    assert [found.nodes[name].kind for name in ("LS", "LC", "LA")] == ["real"] * 3


@pytest.mark.parametrize(
    ("name", "overrides", "does"),
    [
        ("sitl", (), "uploads the mission and starts it"),
        ("ground-station", (), "a person at a ground station gives the orders"),
        ("mitl", (), "steers the mission from the true state"),
        ("mitl-replay", (), "plays recorded motor outputs"),
        ("sitl", ("driver.kind=script", "driver.script=[{at_s: 1, arm: true}]"), "plays a timed script"),
    ],
)
def test_who_gives_the_orders(name: str, overrides: tuple[str, ...], does: str) -> None:
    assert graph(name, *overrides).nodes["D"].does == does


def test_nobody_who_gives_orders_is_no_node() -> None:
    found = graph("sitl", "driver.kind=none")
    assert "D" not in found.nodes
    assert "D" not in found.links


def test_a_profile_writes_only_what_differs(write: Write) -> None:
    path = write(
        "extends: sitl\ngraph:\n  reference: complete\n  nodes:\n"
        "    D: {kind: real, runs_on: person at the controls}\n    PS2: {kind: virtual}\n"
        "  links:\n    PS2: [PS1]\n    LA: []\n",
        "mine.yaml",
    )
    found = graph(str(path))
    assert found.reference == "complete"
    assert (found.nodes["D"].kind, found.nodes["D"].runs_on) == ("real", "person at the controls")
    assert found.nodes["D"].does == "uploads the mission and starts it"
    links = set(graph_from_profile(found).link_names())
    assert links == set(graph_from_profile(graph("sitl")).link_names()) - {"LA-M"} | {"PS1-PS2"}


def test_links_to_a_node_that_is_called_absent_are_left_out() -> None:
    found = graph("sitl", "graph.nodes.M.kind=absent")
    assert graph_from_profile(found).link_names() == ["D-LC", "PS1-LS", "PS1-LA", "LS-LC", "LC-LA"]


def test_links_written_to_an_absent_node_are_refused(write: Write) -> None:
    path = write("extends: sitl\ngraph:\n  links:\n    D: [HC]\n", "mine.yaml")
    with pytest.raises(ProfileError, match=r"mine.yaml:4: graph.links.D: 'HC' is an absent node"):
        load_profile(str(path))


def test_a_node_whose_kind_does_not_follow_needs_one(write: Write) -> None:
    for text, line in (
        ("graph:\n  nodes:\n    HS: {does: nothing}\n", 3),
        ("extends: sitl\ngraph:\n  nodes:\n    HS: {}\n", 4),
    ):
        with pytest.raises(ProfileError, match=rf"mine.yaml:{line}: graph.nodes.HS needs 'kind'; add it"):
            load_profile(str(write(text, "mine.yaml")))


def test_a_part_has_the_graph_that_it_writes() -> None:
    found = graph("boards/beaglebone")
    assert kinds(found) == {"LS": "real", "LC": "real", "LA": "real"}
    assert found.links == {}
    assert load_profile("environments/calm").graph is None


@pytest.mark.parametrize("name", ["hitl-full", "mitl", "paper/eq33-hitl-injected"])
def test_the_graph_written_out_is_read_as_the_same(name: str, write: Write) -> None:
    path = write(resolved_yaml(load_profile(name)), "resolved.yaml")
    assert load_profile(str(path)).graph == graph(name)
