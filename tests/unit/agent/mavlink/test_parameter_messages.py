"""The parameter protocol message by message: the server's answers, the client's list, and PX4's whole numbers."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from agent.mavlink.exchange import text_of
from agent.mavlink.parameters import (
    BATCH,
    QUIET_S,
    ROUNDS,
    ParameterList,
    ParameterServer,
    as_float32,
    bytewise_field,
    bytewise_value,
    same_value,
)
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode

INT8, UINT16, INT32, FLOAT = 2, 3, 6, 9  # MAV_PARAM_TYPE
TYPES = {"SPEED": FLOAT, "MODE": INT8, "SERIAL": INT32, "LOCKED": UINT16, "LAST": FLOAT}


class Vehicle:
    def __init__(self) -> None:
        self.values = dict.fromkeys(TYPES, 1.0)
        self.server = ParameterServer(
            TYPES,
            self.values.__getitem__,
            self._set,
            lambda text: [mav.MAVLink_statustext_message(4, text.encode())],
            per_poll=2,
            read_only=("LOCKED",),
        )

    def _set(self, name: str, value: float) -> None:
        if name not in TYPES:
            raise ValueError(f"{name} does not exist")
        if name == "LOCKED" or not 0.0 <= value <= 9.0:
            raise ValueError(f"{name} = {value:g} is refused")
        self.values[name] = value

    def ask(self, message: Any) -> list[Any]:
        received = decode(Packer(255, 190).pack(message))
        return self.server.handlers[received.get_msgId()](received, 0)


def shown(message: Any) -> tuple[str, float, int, int, int]:
    assert message.get_type() == "PARAM_VALUE"
    return text_of(message.param_id), message.param_value, message.param_type, message.param_index, message.param_count


def test_a_list_is_sent_in_parts_and_begins_anew_when_it_is_asked_for_again() -> None:
    vehicle = Vehicle()
    assert vehicle.server.poll() == []
    assert vehicle.ask(mav.MAVLink_param_request_list_message(1, 1)) == []
    assert [shown(message) for message in vehicle.server.poll()] == [
        ("SPEED", 1.0, FLOAT, 0, 5),
        ("MODE", 1.0, INT8, 1, 5),
    ]
    assert [shown(message)[0] for message in vehicle.server.poll(1)] == ["SERIAL"]
    assert vehicle.server.poll(0) == []
    assert [shown(message)[0] for message in vehicle.server.poll(9)] == ["LOCKED", "LAST"]
    assert vehicle.server.poll() == []
    for _ in range(2):
        vehicle.ask(mav.MAVLink_param_request_list_message(1, 1))
        assert [shown(message)[0] for message in vehicle.server.poll(1)] == ["SPEED"]


@pytest.mark.parametrize(
    ("name", "index", "answered"),
    [
        (b"SERIAL", -1, "SERIAL"),
        (b"SPEED", 4, "LAST"),
        (b"", 0, "SPEED"),
        (b"", 5, None),
        (b"NOTHING", -1, None),
        (b"NOTHING", -2, None),
    ],
)
def test_a_parameter_is_read_by_index_or_by_name(name: bytes, index: int, answered: str | None) -> None:
    found = Vehicle().ask(mav.MAVLink_param_request_read_message(1, 1, name, index))
    assert [shown(message)[0] for message in found] == ([] if answered is None else [answered])


@pytest.mark.parametrize(
    ("name", "value", "after", "reason"),
    [
        ("SPEED", 2.5, 2.5, None),
        ("SPEED", 9.5, 1.0, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
        ("LOCKED", 2.0, 1.0, mav.MAV_PARAM_ERROR_READ_ONLY),
        ("NOTHING", 2.0, None, mav.MAV_PARAM_ERROR_DOES_NOT_EXIST),
    ],
)
def test_a_set_parameter_is_answered_with_its_value_and_a_refusal_with_the_reason(
    name: str, value: float, after: float | None, reason: int | None
) -> None:
    vehicle = Vehicle()
    found = vehicle.ask(mav.MAVLink_param_set_message(1, 1, name.encode(), value, FLOAT))
    values = [shown(message)[:2] for message in found if message.get_type() == "PARAM_VALUE"]
    assert values == ([] if after is None else [(name, after)])
    errors = [message for message in found if message.get_type() == "PARAM_ERROR"]
    assert [error.error for error in errors] == ([] if reason is None else [reason])
    assert sum(message.get_type() == "STATUSTEXT" for message in found) == len(errors)
    for error in errors:
        assert (error.target_system, error.target_component, error.param_index) == (255, 190, -1)
        assert text_of(error.param_id) == name


def value_of(index: int, count: int, value: float = 0.5) -> Any:
    return mav.MAVLink_param_value_message(f"P{index}".encode(), value, FLOAT, count, index)


QUIET_NS = round(QUIET_S * 1e9)


def test_lost_parameters_are_asked_for_by_their_index() -> None:
    exchange = ParameterList((1, 1), lambda message: float(message.param_value))
    (request,) = exchange.poll(0)
    assert request.get_type() == "PARAM_REQUEST_LIST"
    count = BATCH + 5
    for index in (0, 2):
        exchange.handle(value_of(index, count), 10)
    exchange.handle(value_of(count, count), 10)  # beyond its own count
    assert exchange.count == count
    assert exchange.poll(10 + QUIET_NS - 1) == []
    asked = exchange.poll(10 + QUIET_NS)
    assert [message.param_index for message in asked] == [1, *range(3, BATCH + 2)]
    assert all(message.get_type() == "PARAM_REQUEST_READ" for message in asked)
    now_ns = 10 + QUIET_NS
    for message in asked:
        exchange.handle(value_of(message.param_index, count), now_ns)
    asked = exchange.poll(now_ns + 1)
    assert [message.param_index for message in asked] == list(range(BATCH + 2, count)), "without a pause"
    assert not exchange.done
    for message in asked:
        exchange.handle(value_of(message.param_index, count, 7.0), now_ns)
    assert exchange.complete
    assert exchange.poll(now_ns + 2) == []
    assert exchange.done
    assert list(exchange.values) == [f"P{index}" for index in range(count)]
    assert (exchange.values["P0"], exchange.values[f"P{count - 1}"]) == (0.5, 7.0)


@pytest.mark.parametrize("some", [False, True])
def test_a_list_is_given_up_after_some_rounds_without_an_answer(some: bool) -> None:
    exchange, now_ns, rounds = ParameterList((1, 1), lambda message: 0.0), 0, 0
    exchange.poll(now_ns)
    if some:
        exchange.handle(value_of(0, 3), now_ns)
        now_ns += QUIET_NS
        assert [message.param_index for message in exchange.poll(now_ns)] == [1, 2]
    while not exchange.done:
        now_ns += QUIET_NS
        asked = exchange.poll(now_ns)
        rounds += 1
        assert bool(asked) is not exchange.done
    assert rounds == ROUNDS
    assert not exchange.complete


@pytest.mark.parametrize(
    ("kind", "value"), [(INT32, -70_000.0), (INT32, 2.0**31 - 1.0), (UINT16, 65_535.0), (INT8, -128.0), (FLOAT, 1.5)]
)
def test_whole_numbers_of_px4_are_the_raw_bytes_of_the_field(kind: int, value: float) -> None:
    field = bytewise_field(value, kind)
    raw = struct.pack("<f", field)
    if kind == FLOAT:
        assert field == value
    else:
        assert (
            int.from_bytes(
                raw[:2] if kind == UINT16 else raw[:1] if kind == INT8 else raw, "little", signed=kind != UINT16
            )
            == value
        )
    assert bytewise_value(mav.MAVLink_param_value_message(b"P", field, kind, 1, 0)) == value


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (INT32, 2.0**31),
        (INT32, 0.5),
        (UINT16, -1.0),
        (UINT16, 65_536.0),
        (INT8, 128.0),
        (INT8, math.nan),
        (INT8, math.inf),
    ],
)
def test_a_value_that_a_type_cannot_hold_is_refused(kind: int, value: float) -> None:
    with pytest.raises(ValueError, match="is not a value of this integer parameter; use a whole number"):
        bytewise_field(value, kind)


def test_values_are_the_same_as_floats_of_32_bits() -> None:
    assert same_value(0.1, as_float32(0.1))
    assert not same_value(0.1, 0.1 + 1e-7)
    assert (as_float32(1e39), as_float32(-1e39)) == (math.inf, -math.inf)
