"""`xitl sim --ros`: with and without a value, wherever it stands."""

from __future__ import annotations

import pytest
import typer
from typer.core import TyperCommand

from tests.golden import Golden
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


def test_it_is_keys_of_the_profile(golden: Golden) -> None:
    assert ros_options(None, False) == {}
    assert ros_options("ros2", False) == {"ros.enabled": "true", "ros.master": "null"}
    assert ros_options("ros1://box:5", False) == {"ros.enabled": "true", "ros.master": "ros1://box:5"}
    assert ros_options(None, True) == {"ros.enabled": "false"}
    with pytest.raises(UserError) as refused:
        ros_options("box", False)
    golden("error", refused.value)
    with pytest.raises(UserError, match="--ros contradicts --no-ros"):
        ros_options("ros2", True)


def test_what_went_out_and_was_dropped_is_told_at_the_end(golden: Golden) -> None:
    ros = {
        "published": {"/clock": 2, "/fix": 1},
        "received": {"/arm": 1},
        "refused": 1,
        "dropped": {"/lidar/points": 3},
    }
    rows = list(ros_rows({"ros": ros}))
    assert [head for head, _ in rows] == ["ROS", "ROS"]
    golden("rows", [text for _, text in rows], "3 messages on 2 topics", "1 in", "3 recorded messages")
    assert list(ros_rows({})) == []
