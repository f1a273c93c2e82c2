"""Where ground stations meet the autopilot of a run: at ports that are free, and that no run beside it takes."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from agent.roles.ground_stations import GroundStations
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.run.links import stations
from xitl_cli.run.links.stations import StationAddresses


@pytest.fixture
def holder() -> Iterator[socket.socket]:
    """A program that listens at all addresses of a port that has free ones behind it."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        sock.bind(("0.0.0.0", 0))
        sock.listen()
        yield sock


def addresses(*urls: str, name: str = "hitl-loopback") -> StationAddresses:
    return StationAddresses(load_profile(name, [f"autopilot.ground_stations=[{', '.join(urls)}]"]).runnable())


def port(url: str) -> int:
    return int(url.rpartition(":")[2])


def test_in_real_time_only_this_machine_may_call() -> None:
    made = StationAddresses(load_profile("sitl", ["clock.mode=realtime"]).runnable())
    made.close()
    assert [url.rpartition(":")[0] for url in made.urls] == ["udp://127.0.0.1", "tcp://127.0.0.1"]


def test_a_port_in_use_is_replaced_by_the_next_free_one_and_said(holder: socket.socket) -> None:
    taken = holder.getsockname()[1]
    made = addresses("udp://127.0.0.1:14550", f"tcp://127.0.0.1:{taken}")
    assert made.urls[0] == "udp://127.0.0.1:14550"
    assert taken < port(made.urls[1]) < taken + stations.TRIED
    (text,) = made.warnings
    assert f"TCP port {taken} is in use" in text
    assert made.urls[1] in text
    GroundStations([made.urls[1]], 1, 1).close()  # it is free indeed
    made.close()


def test_runs_that_start_together_take_different_ports_before_any_listens(holder: socket.socket) -> None:
    before = addresses(f"tcp://127.0.0.1:{holder.getsockname()[1]}")
    first = port(before.urls[0])
    before.close()
    together = [addresses(f"tcp://127.0.0.1:{first}", "udp://127.0.0.1:14550") for _ in range(3)]
    assert len({made.urls[0] for made in together}) == 3
    for made in together:
        made.close()
    again = addresses(f"tcp://127.0.0.1:{first}")
    assert (port(again.urls[0]), again.warnings) == (first, [])
    again.close()


def test_no_port_left_is_an_error(holder: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stations, "TRIED", 1)
    with pytest.raises(UserError, match=r"autopilot.ground_stations: tcp://.* in use; give another port"):
        addresses(f"tcp://127.0.0.1:{holder.getsockname()[1]}")


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        ("hitl-beaglebone", ["0.0.0.0"], "start the agent there with --gcs tcp://0.0.0.0:5760"),
        ("hitl-loopback", ["'no address'"], "is no address and no interface"),
    ],
)
def test_an_interface_that_cannot_be(name: str, overrides: list[str], words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        load_profile(name, [f"autopilot.ground_station_interface={text}" for text in overrides])


def test_an_interface_beside_addresses_that_have_theirs_is_refused() -> None:
    given = ["autopilot.ground_stations=[]", "autopilot.ground_station_interface=0.0.0.0"]
    with pytest.raises(ProfileError, match="goes with the usual addresses"):
        load_profile("hitl-loopback", given)
