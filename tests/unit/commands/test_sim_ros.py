"""`xitl sim --ros`: with and without a value, wherever it stands."""

from __future__ import annotations

import pytest
import typer
from typer.core import TyperCommand

from xitl_cli.commands.sim import SimCommand, ros_options, sim
from xitl_cli.commands.sim_report import ros_rows
from xitl_cli.errors import UserError


def parsed(*arguments: str) -> tuple[str | None, str | None]:
    """Profile and value of `--ros`."""
    app = typer.Typer()
    app.command(cls=SimCommand)(sim)
    command = typer.main.get_command(app)
    assert isinstance(command, TyperCommand)
    found = command.make_context("sim", list(arguments)).params
    return found["profile"], found["ros"]


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("sitl",), ("sitl", None)),
        (("--ros", "sitl"), ("sitl", "ros2")),
        (("sitl", "--ros"), ("sitl", "ros2")),
        (("sitl", "--ros", "--duration", "5"), ("sitl", "ros2")),
        (("sitl", "--ros", "ros2"), ("sitl", "ros2")),
        (("--ros", "ros1://localhost:11311", "sitl"), ("sitl", "ros1://localhost:11311")),
        (("sitl", "--ros=ros1://box:5"), ("sitl", "ros1://box:5")),
    ],
)
def test_the_value_may_be_left_out(arguments: tuple[str, ...], found: tuple[str, str | None]) -> None:
    assert parsed(*arguments) == found


def test_it_is_keys_of_the_profile() -> None:
    assert ros_options(None, False) == {}
    assert ros_options("ros2", False) == {"ros.enabled": "true", "ros.master": "null"}
    assert ros_options("ros1://box:5", False) == {"ros.enabled": "true", "ros.master": "ros1://box:5"}
    assert ros_options(None, True) == {"ros.enabled": "false"}
    with pytest.raises(UserError, match="--ros box: names no ROS; use --ros, or --ros ros1://localhost:11311"):
        ros_options("box", False)
    with pytest.raises(UserError, match="are opposites"):
        ros_options("ros2", True)


def test_what_went_out_and_was_dropped_is_told_at_the_end() -> None:
    ros = {
        "published": {"/clock": 2, "/fix": 1},
        "received": {"/arm": 1},
        "refused": 1,
        "dropped": {"/lidar/points": 3},
    }
    assert list(ros_rows({"ros": ros})) == [
        ("ROS", "3 messages on 2 topics out, 1 in, of which 1 not taken"),
        ("ROS", "3 recorded messages came too fast for the bridge and were dropped, most of /lidar/points"),
    ]
    assert list(ros_rows({})) == []
