"""Settings of a companion by the standard parameter protocol."""

from __future__ import annotations

import math

import pytest

from agent.companion.settings import TABLE, CompanionParameters, checked_parameter
from agent.mavlink.parameter_rows import ParameterError
from agent.wire import dialect as mav
from tests.golden import Golden


def ask(name: str, value: float) -> mav.MAVLink_param_set_message:
    message = mav.MAVLink_param_set_message(1, 191, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32)
    message.param_id = name
    return message


def test_defaults_are_within_their_range_and_names_are_sorted_and_fit_the_wire() -> None:
    assert [row.name for row in TABLE] == sorted(row.name for row in TABLE)
    for row in TABLE:
        assert checked_parameter(row.name, row.default) == row.default
        assert len(row.name) <= 16


def test_a_setting_is_set_and_answered() -> None:
    refused: list[str] = []
    settings = CompanionParameters(refused.append)
    (answer,) = settings.handle(ask("AVD_MARGIN", 4.5))
    assert (answer.param_value, settings["AVD_MARGIN"], refused) == (4.5, 4.5, [])


@pytest.mark.parametrize("value", [-1.0, 31.0, math.nan, math.inf])
def test_nonsense_is_refused_with_the_value_in_force(value: float) -> None:
    refused: list[str] = []
    settings = CompanionParameters(refused.append)
    kept, error = settings.handle(ask("AVD_MARGIN", value))
    assert kept.param_value == settings["AVD_MARGIN"] == 3.0
    assert isinstance(error, mav.MAVLink_param_error_message)
    assert "out of range; use 0.5 to 30 m" in refused[0]


def test_an_unknown_one_is_named(golden: Golden) -> None:
    refused: list[str] = []
    (error,) = CompanionParameters(refused.append).handle(ask("AVD_MARGEN", 1.0))
    assert (error.get_type(), error.error) == ("PARAM_ERROR", mav.MAV_PARAM_ERROR_DOES_NOT_EXIST)
    golden("text", refused[0])
    with pytest.raises(ParameterError):
        checked_parameter("WP_RADIUS", 1.0)


def test_all_are_listed_and_each_can_be_read() -> None:
    settings = CompanionParameters()
    listed = settings.handle(mav.MAVLink_param_request_list_message(1, 191))
    assert [value.param_index for value in listed] == list(range(len(TABLE)))
    (one,) = settings.handle(mav.MAVLink_param_request_read_message(1, 191, b"", 3))
    assert one.param_value == settings[TABLE[3].name]
    assert settings.handle(mav.MAVLink_param_request_read_message(1, 191, b"", len(TABLE))) == []
