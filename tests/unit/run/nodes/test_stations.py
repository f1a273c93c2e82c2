"""Where ground stations meet the autopilots of a run: at ports that are free, and that no run beside it takes."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest

from agent.roles.ground_stations import GroundStations
from tests.free_ports import free_port
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.links import ports
from xitl_cli.run.nodes import stations
from xitl_cli.run.nodes.stations import StationAddresses


@pytest.fixture
def holder() -> Iterator[socket.socket]:
    """A program that listens at all addresses of a port that has free ones behind it."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        sock.bind(("0.0.0.0", 0))
        sock.listen()
        yield sock


@pytest.fixture
def usual(holder: socket.socket, monkeypatch: pytest.MonkeyPatch) -> int:
    """The usual port, which is taken."""
    port: int = holder.getsockname()[1]
    monkeypatch.setattr("xitl_cli.profile.schema.profile.USUAL", ("udp://127.0.0.1:14550", port))
    return port


def single(name: str = "hitl-loopback", *urls: str) -> StationAddresses:
    given = [f"autopilot.ground_stations=[{', '.join(urls)}]"] if urls else []
    return StationAddresses([load_profile(name, given).runnable()])


def port(url: str) -> int:
    return int(url.rpartition(":")[2])


def test_in_real_time_only_this_machine_may_call() -> None:
    made = StationAddresses([load_profile("sitl", ["clock.mode=realtime"]).runnable()])
    made.close()
    assert [url.rpartition(":")[0] for url in made.of("").urls] == ["udp://127.0.0.1", "tcp://127.0.0.1"]
    assert made.of("").told == made.of("").urls
    assert made.report() == {}


@pytest.mark.parametrize(
    ("camera", "routed"),
    [("{serve: 'http://127.0.0.1:8600'}", True), ("{gimbal: {}}", True), ("{name: fixed}", False)],
)
def test_a_camera_that_stations_may_find_is_behind_a_router(camera: str, routed: bool) -> None:
    given = [f"autopilot.ground_stations=[tcp://127.0.0.1:{free_port()}]", f"sensors.cameras=[{camera}]"]
    made = StationAddresses([load_profile("hitl-loopback", given).runnable()])
    assert bool(made.components_url) is routed
    assert (made.of("").urls == made.of("").told) is not routed
    assert len(made.of("").told) == 1
    made.close()
    assert bool(made.report()) is routed


def test_a_usual_port_in_use_is_replaced_by_the_next_free_one_and_said(usual: int) -> None:
    made = single()
    first, second = made.of("").urls
    assert first == "udp://127.0.0.1:14550"
    assert usual < port(second) < usual + ports.TRIED
    (text,) = made.warnings
    assert f"TCP port {usual} is in use" in text
    assert second in text
    GroundStations([second], 1, 1).close()  # it is free indeed
    made.close()


def test_a_port_that_the_profile_gives_is_not_replaced(holder: socket.socket, golden: Golden) -> None:
    """Somebody may have been told of it, such as a ground station that is set up already."""
    url = f"tcp://127.0.0.1:{holder.getsockname()[1]}"
    with pytest.raises(UserError) as refused:
        single("hitl-loopback", url)
    golden("error", refused.value, url=url)
    holder.close()
    made = single("hitl-loopback", url)
    assert (made.of("").urls, made.warnings) == ((url,), [])
    made.close()


def test_runs_that_start_together_take_different_ports_before_any_listens(usual: int) -> None:
    together = [single() for _ in range(3)]
    found = [port(made.of("").urls[1]) for made in together]
    assert all(one < other for one, other in pairwise([usual, *found]))
    for made in together:
        made.close()
    again = single()
    assert port(again.of("").urls[1]) == found[0]
    again.close()


def test_no_port_left_is_an_error(usual: int, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    monkeypatch.setattr(ports, "TRIED", 1)
    with pytest.raises(UserError) as refused:
        single()
    golden("error", refused.value, port=usual)


def fleet(
    *names: str, overrides: tuple[str, ...] = ("clock.mode=realtime",), **other: tuple[str, ...]
) -> list[RunProfile]:
    """A profile a vessel, with system ids from 1; `other` has further overrides by vessel."""
    return [
        replace(
            load_profile("sitl", [f"autopilot.system_id={number}", *overrides, *other.get(name, ())]).runnable(),
            vessel=name,
        )
        for number, name in enumerate(names, start=1)
    ]


@pytest.mark.medium
def test_a_fleet_is_met_together_and_each_on_its_own(usual: int) -> None:
    made = StationAddresses(fleet("one", "two", "three"))
    together = [made.of(name).told for name in ("one", "two", "three")]
    assert together == [("udp://127.0.0.1:14550", f"tcp://127.0.0.1:{port(together[0][1])}")] * 3
    assert usual < port(together[0][1])
    routed = {made.of(name).urls[0] for name in ("one", "two", "three")}
    assert len(routed) == 1
    assert routed.pop().startswith("udp://127.0.0.1:")
    alone = [port(made.of(name).urls[1]) for name in ("one", "two", "three")]
    assert len({*alone, port(together[0][1])}) == 4
    assert all(one >= usual + stations.STEP * number for number, one in enumerate(alone, start=1))
    assert [made.of(name).own for name in ("one", "two", "three")] == [(f"tcp://127.0.0.1:{one}",) for one in alone]
    made.close()
    report = made.report()["ground_stations"]
    assert report["fleet"] == list(together[0])
    assert report["vessels"]["two"] == [f"tcp://127.0.0.1:{alone[1]}"]
    assert report["frames_in"] == 0


@pytest.mark.medium
def test_addresses_of_one_vessel_are_its_own_and_shared_ones_the_fleets() -> None:
    together, free = free_port(), free_port()
    given = (f"autopilot.ground_stations=[tcp://127.0.0.1:{together}, udp://10.0.0.9:14550]",)
    own = (f"autopilot.ground_stations=[tcp://127.0.0.1:{free}]",)
    made = StationAddresses(fleet("one", "two", "three", overrides=given, three=own))
    assert made.of("three").urls[1:] == (f"tcp://127.0.0.1:{free}",)
    assert made.of("one").told[1] == made.of("two").told[1] == made.of("three").told[1] == "udp://10.0.0.9:14550"
    assert port(made.of("one").told[0]) == together
    assert made.of("one").urls[1] != made.of("two").urls[1]
    made.close()


def test_in_lockstep_there_is_none_unless_asked_for() -> None:
    made = StationAddresses(fleet("one", "two", overrides=()))
    assert made.of("one").urls == made.of("two").told == ()
    made.close()
    assert made.report() == {}


@pytest.mark.medium
def test_who_was_never_heard_is_said(golden: Golden) -> None:
    made = StationAddresses(fleet("one", "two"))
    made.close()
    one, two = made.report()["warnings"]
    golden("text", one)
    assert two.startswith("two (system 2) sent nothing")


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        ("hitl-beaglebone", ["0.0.0.0"], "start the agent there with --gcs tcp://0.0.0.0:5760"),
        ("hitl-loopback", ["'no address'"], "is neither an address nor an interface"),
    ],
)
def test_an_interface_that_cannot_be(name: str, overrides: list[str], words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        load_profile(name, [f"autopilot.ground_station_interface={text}" for text in overrides])


def test_an_interface_beside_addresses_that_have_theirs_is_refused() -> None:
    given = ["autopilot.ground_stations=[]", "autopilot.ground_station_interface=0.0.0.0"]
    with pytest.raises(ProfileError, match="applies to the default addresses only"):
        load_profile("hitl-loopback", given)
