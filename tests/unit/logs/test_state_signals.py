"""States by made logs of each kind: arming, modes, parameters, outputs, cores and missions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

import xitl_cli.logs.signals as signals
from xitl_cli.logs.signals.missions import mission_rows, mission_versions
from xitl_cli.logs.signals.states import (
    armed_rows,
    arming_known,
    autopilot_heartbeats,
    autopilot_messages,
    error_rows,
    event_rows,
    firmware_text,
    first_text,
    lanes,
    last_parameters,
    output_names,
    parameter_rows,
    parameter_values,
    rc_inputs,
    rows_in_use,
    sensors_simulated,
    texts,
    vehicle_kind,
)
from xitl_cli.plugins.logs.analyses.outputs import OutputChannel, OutputRange, driven_outputs

S = 1_000_000_000
END = MadeTable("ATT", [0, 100 * S], {"Roll": [0.0, 0.0]})


def table(name: str, at_s: Any = None, /, *, instance: str | None = None, **columns: Any) -> MadeTable:
    rows = len(next(iter(columns.values())))
    at_ns = np.round(np.asarray(range(rows) if at_s is None else at_s) * float(S)).astype(np.int64)
    return MadeTable(name, at_ns, columns, instance=instance)


def log_of(*tables: MadeTable, kind: Any = "dataflash", **of: Any) -> MadeLog:
    return MadeLog(*tables, kind=kind, **of)


def spans(log: MadeLog, read: Any = signals.armed) -> list[tuple[float, float, str, str]]:
    return [(span.from_ns / S, span.until_ns / S, span.text, span.source) for span in read(log)]


# Arming


@pytest.mark.parametrize(
    ("rows", "kind", "expected"),
    [
        (table("ARM", [10, 30, 40], ArmState=[1, 0, 1]), "dataflash", [(10, 30), (40, 100)]),
        (table("ARM", [30], ArmState=[0]), "dataflash", [(0, 30)]),  # it was armed when the log began
        (table("ARM", [0, 5], ArmState=[0, 1]), "dataflash", [(5, 100)]),
        (table("EV", [10, 20, 30, 40], Id=[10, 25, 11, 10]), "dataflash", [(10, 30), (40, 100)]),
        (table("EV", [10, 30], Id=[10, 10]), "dataflash", [(10, 30), (30, 100)]),  # an old copter stops logging first
        (table("ARM", [10, 30], ArmState=[1, 1]), "dataflash", [(10, 100)]),
        (table("MSG", [10, 20, 30], Message=["Throttle armed", "x", "Throttle disarmed"]), "dataflash", [(10, 30)]),
        (table("MSG", [30], Message=["Disarming motors"]), "dataflash", [(0, 30)]),
        (table("STAT", [0, 10, 30], Armed=[0, 1, 0]), "dataflash", [(10, 30)]),
        (table("/actuators", [0, 10, 30], armed=[0, 1, 0]), "mcap", [(10, 30)]),
        (
            table("HEARTBEAT", [0, 10, 30], autopilot=[3] * 3, type=[11] * 3, custom_mode=[0] * 3,
            base_mode=[1, 129, 81]),
            "tlog", [(10, 30)],
        ),
        (table("vehicle_status", [0, 10, 30], arming_state=[1, 2, 1]), "ulog", [(10, 30)]),
        (table("/mavros/state", [0, 10, 30], armed=[False, True, False]), "rosbag2", [(10, 30)]),
        (table("EV", [10], Id=[25]), "dataflash", []),
    ],
)  # fmt: skip
def test_armed_by_every_kind_of_row(rows: MadeTable, kind: Any, expected: list[tuple[float, float]]) -> None:
    log = log_of(rows, END, kind=kind)
    assert [span[:2] for span in spans(log)] == expected
    at = np.array([0, 9, 10, 30, 31, 100]) * S
    on = armed_rows(log, at)
    if rows.name != "EV" or expected:
        assert on is not None
        assert on.tolist() == [any(a * S <= stamp <= b * S for a, b in expected) for stamp in at.tolist()]


@pytest.mark.parametrize(
    ("tables", "kind", "known"),
    [
        ([table("ARM", ArmState=[0])], "dataflash", True),
        ([table("/link/agent/rx:HEARTBEAT", autopilot=[3])], "mcap", True),
        ([table("MSG", Message=["x"]), table("PARM", Name=["LOG_DISARMED"], Value=[1.0])], "dataflash", True),
        ([table("MSG", Message=["x"]), table("PARM", Name=["LOG_DISARMED"], Value=[0.0])], "dataflash", False),
        ([table("MSG", Message=["x"])], "dataflash", False),
        ([table("PARM", Name=["LOG_DISARMED"], Value=[1.0])], "dataflash", False),
        ([table("MSG", Message=["x"]), table("PARM", Name=["LOG_DISARMED"], Value=[1.0])], "mcap", False),
    ],
)
def test_whether_a_log_would_show_an_arming(tables: list[MadeTable], kind: Any, known: bool) -> None:
    log = log_of(*tables, kind=kind)
    assert arming_known(log) is known
    assert (armed_rows(log, np.array([5])) is None) is not known


# Modes, texts and rows


def test_modes_have_the_names_of_the_vehicle() -> None:
    rover = table("MSG", Message=["ArduRover V4.5.0"])
    mode = table("MODE", [10, 20, 20.5, 40], ModeNum=[0, 10, 10, 99], Mode=[5, 5, 5, 5])
    assert spans(log_of(mode, rover, END), signals.modes) == [
        (10, 20, "MANUAL", "MODE.ModeNum"), (20, 40, "AUTO", "MODE.ModeNum"), (40, 100, "mode 99", "MODE.ModeNum"),
    ]  # fmt: skip
    assert [span[2] for span in spans(log_of(table("MODE", Mode=[4]), rover), signals.modes)] == ["HOLD"]
    px4 = table("vehicle_status", [0, 5], nav_state=[4, 3])
    assert [span[2:] for span in spans(log_of(px4, END, kind="ulog"), signals.modes)] == [
        ("Hold", "vehicle_status.nav_state"), ("Mission", "vehicle_status.nav_state"),
    ]  # fmt: skip
    bridge = table("/mavros/state", [0, 5, 6], mode=["MANUAL", "AUTO", "AUTO"])
    assert spans(log_of(bridge, END, kind="rosbag2"), signals.modes) == [
        (0, 5, "MANUAL", "/mavros/state.mode"), (5, 100, "AUTO", "/mavros/state.mode"),
    ]  # fmt: skip
    beats = table(
        "/link/agent/rx:HEARTBEAT", [0, 5], autopilot=[3, 3], type=[11, 11], custom_mode=[10, 4], base_mode=[0, 0]
    )
    assert [span[2] for span in spans(log_of(beats, END, kind="mcap"), signals.modes)] == ["AUTO", "HOLD"]
    assert spans(log_of(END), signals.modes) == []


def test_the_last_state_lasts_to_the_end_of_the_log_and_rows_may_be_out_of_order() -> None:
    mode = table("MODE", [40, 10, 20], ModeNum=[3, 1, 2])
    assert [span[:3] for span in spans(log_of(mode, END), signals.modes)] == [
        (10, 20, "mode 1"), (20, 40, "mode 2"), (40, 100, "mode 3"),
    ]  # fmt: skip
    assert spans(log_of(mode), signals.modes)[-1][:2] == (40, 40)


def beats(*rows: tuple[int, int, int]) -> MadeTable:
    """system, autopilot, type"""
    system, autopilot, kind = (list(each) for each in zip(*rows, strict=True))
    zeros = [0] * len(rows)
    return table("HEARTBEAT", _sysid=system, autopilot=autopilot, type=kind, custom_mode=zeros, base_mode=zeros)


def test_the_autopilot_is_the_first_sender_that_is_one() -> None:
    log = log_of(
        beats((255, 8, 6), (1, 3, 11), (2, 3, 2), (1, 8, 26), (1, 3, 11)),
        table("ATTITUDE", _sysid=[2, 1, 255, 1], yaw=[20.0, 1.0, 7.0, 2.0]), kind="tlog",
    )  # fmt: skip
    own = autopilot_heartbeats(log)
    assert own is not None
    assert own.stamp_ns.tolist() == [1 * S, 4 * S]
    attitude = autopilot_messages(log, "ATTITUDE")
    assert attitude is not None
    assert attitude.values("yaw").tolist() == [1.0, 2.0]
    assert autopilot_messages(log, "RAW_IMU") is None
    assert autopilot_messages(log_of(table("ATTITUDE", _sysid=[2], yaw=[1.0])), "ATTITUDE") is not None
    assert autopilot_heartbeats(log_of(beats((255, 8, 6)))) is None
    nobody = log_of(beats((1, 3, 2)), table("ATTITUDE", _sysid=[2], yaw=[1.0]))
    assert autopilot_messages(nobody, "ATTITUDE") is None


@pytest.mark.parametrize(
    ("tables", "kind"),
    [
        ([table("VER", BU=[2, 1])], "rover"),
        ([table("VER", BU=[0]), table("MSG", Message=["ArduCopter V4.5"])], "copter"),
        ([table("MSG", Message=["hello", "ArduPlane V4.5"])], "plane"),
        ([table("STATUSTEXT", text=["ArduSub V4.1"])], "sub"),
        ([beats((1, 3, 11))], "rover"),
        ([beats((1, 12, 11))], "unknown"),  # the numbers of modes are ArduPilot's
        ([table("MSG", Message=["x"] * 200 + ["ArduPlane V4.5"])], "unknown"),
        ([table("MSG", Message=["x"] * 199 + ["ArduPlane V4.5"])], "plane"),
        ([], "unknown"),
    ],
)
def test_the_kind_of_vehicle(tables: list[MadeTable], kind: str) -> None:
    assert vehicle_kind(log_of(*tables, END)) == kind


def test_the_name_of_the_firmware() -> None:
    assert firmware_text(log_of(table("MSG", Message=["x", "APM:Rover v2.5 ", "ArduCopter V4"]))) == "APM:Rover v2.5"
    assert firmware_text(log_of(table("/log", message=["xitl, messages as ArduRover V4.5"]))) is not None
    assert firmware_text(log_of(table("MSG", Message=["Roverland"]))) is None


def test_texts_in_order_of_time() -> None:
    log = log_of(
        table("MSG", [3, 9], Message=["b", "d"]), table("STATUSTEXT", [1, 5], text=["a", "c"], severity=[4, 6]),
        table("/log", [7], message=["e"]),
    )  # fmt: skip
    assert [(text.at_ns / S, text.text, text.severity, text.source) for text in texts(log)] == [
        (1, "a", 4, "STATUSTEXT.text"), (3, "b", None, "MSG.Message"), (5, "c", 6, "STATUSTEXT.text"),
        (7, "e", None, "/log.message"), (9, "d", None, "MSG.Message"),
    ]  # fmt: skip


def test_rows_of_errors_and_events() -> None:
    log = log_of(table("ERR", [5, 2], Subsys=[3, 1], ECode=[4, 2]), table("EV", [5, 2], Id=[10, 11]))
    assert error_rows(log) == [(2 * S, 1, 2), (5 * S, 3, 4)]
    assert event_rows(log) == [(5 * S, 10), (2 * S, 11)]
    assert error_rows(log_of(table("ERR", Subsys=["a"], ECode=["b"]))) == []
    assert (error_rows(log_of(END)), event_rows(log_of(END))) == ([], [])


def test_the_first_text_with_a_beginning() -> None:
    said = table("MSG", Message=["x"] * 49 + ["Lockstep: yes", "Lockstep: no"])
    assert first_text(log_of(said), "Lockstep:") == (49 * S, "Lockstep: yes")
    assert first_text(log_of(table("MSG", Message=["x"] * 50 + ["Lockstep: yes"])), "Lockstep:") is None


# Parameters


def test_parameters_by_every_kind_of_row() -> None:
    parm = table(
        "PARM", Name=["A", "B", "", "A", "C"], Value=[1.0, 2.0, 3.0, 4.0, np.nan], Default=[1.0, np.nan, 0.0, 1.0, 0.0]
    )
    log = log_of(parm)
    assert [(row.at_ns / S, row.name, row.value, row.default, row.source) for row in parameter_rows(log)] == [
        (0, "A", 1.0, 1.0, "PARM"), (1, "B", 2.0, None, "PARM"), (3, "A", 4.0, 1.0, "PARM"),
    ]  # fmt: skip
    assert last_parameters(log) == {"A": 4.0, "B": 2.0}
    assert parameter_values(log) == {"A": 4.0, "B": 2.0, "": 3.0}
    asked = table("PARAM_VALUE", param_id=["A"], param_value=[7.0])
    assert parameter_rows(log_of(asked))[0].source == "PARAM_VALUE"
    assert parameter_values(log_of(asked, parm))["A"] == 4.0
    px4 = log_of(table("parameters", name=["P"], value=[9.0]), kind="ulog")
    assert (last_parameters(px4), parameter_values(px4)) == ({"P": 9.0}, {"P": 9.0})
    assert parameter_rows(log_of(END)) == []


# Cores


def test_the_rows_of_the_core_in_use() -> None:
    core = table("XKF1", [0, 0, 1, 1, 2, 2, 3, 3], C=[0, 1] * 4, VN=np.arange(8.0))
    in_use = table("XKF4", [0.9, 1.5, 2.0], PI=[0, 1, 0])
    found = rows_in_use(log_of(core, in_use), "XKF1")
    assert found is not None
    assert found.values("VN").tolist() == [0.0, 2.0, 4.0, 6.0]  # at 1 s core 0; at 2 s core 0 again
    in_use = table("XKF4", [1.5, 0.9, 2.5], PI=[1, 0, 0])
    known = lanes(log_of(in_use), "XKF")
    assert known is not None
    assert (known[0].tolist(), known[1].tolist()) == ([900_000_000, 1_500_000_000, 2_500_000_000], [0, 1, 0])
    found = rows_in_use(log_of(core, in_use), "XKF1")
    assert found is not None
    assert found.values("VN").tolist() == [0.0, 2.0, 5.0, 6.0]
    other = rows_in_use(log_of(core, table("XKF4", PI=[7])), "XKF1")
    assert other is not None
    assert len(other) == 8
    assert lanes(log_of(core), "XKF") is None


# Outputs and inputs


def test_pulses_by_channel() -> None:
    log = log_of(
        table("RCOU", C1=[1500, 1600], C3=[0, 0], Chan10=[1100, 1100], X=[1, 1]),
        table("RCO2", C3=[1200, 1300], C1=[9, 9]),
        table("RCIN", C2=[1400, 1401]), table("RC_CHANNELS", chan2_raw=[1, 1], chan5_raw=[1700, 1701]),
    )  # fmt: skip
    found = signals.outputs(log)
    assert {channel: (series.values.tolist(), series.source) for channel, series in found.items()} == {
        1: ([1500, 1600], "RCOU.C1"), 3: ([1200, 1300], "RCO2.C3"), 10: ([1100, 1100], "RCOU.Chan10"),
    }  # fmt: skip
    assert {channel: series.source for channel, series in rc_inputs(log).items()} == {
        2: "RCIN.C2", 5: "RC_CHANNELS.chan5_raw",
    }  # fmt: skip
    bridged = table("/mavros/rc/out", channels=np.array([[1500, 0, 1100]]))
    assert list(signals.outputs(log_of(bridged, kind="rosbag2"))) == [1, 3]
    assert signals.outputs(log_of(bridged)) == {}


def test_commands_of_a_run_have_names() -> None:
    actuators = table(
        "/actuators", command=np.array([[0.5, 0.0], [0.6, 0.0]]), names=["a, b", "propeller 0, rudder 1"], armed=[1, 1]
    )
    log = log_of(actuators, kind="mcap")
    found = signals.outputs(log)
    assert {channel: (series.values.tolist(), series.unit) for channel, series in found.items()} == {
        1: ([0.5, 0.6], ""), 2: ([0.0, 0.0], ""),
    }  # fmt: skip
    assert output_names(log) == {1: "propeller 0", 2: "rudder 1"}
    assert output_names(log_of(END)) == {}
    port, rudder = driven_outputs(
        log_of(
            table(
                "/actuators",
                command=np.array([[0.5, 0.1], [0.6, 0.0]]),
                names=["propeller 0, rudder 1"] * 2,
                armed=[0, 1],
            ),
            kind="mcap",
        ),
        {},
    )
    assert (port.name, port.drives, port.arming_known, port.armed.tolist()) == ("motor 1", True, True, [False, True])
    assert (rudder.name, rudder.drives, rudder.command.tolist(), rudder.known) == ("rudder 1", False, [0.1, 0.0], True)
    (unarmed,) = driven_outputs(log_of(table("/actuator", command=[1]), table("RCOU", C1=[1500, 1600])), {})
    assert (unarmed.arming_known, unarmed.armed.tolist(), unarmed.function) == (False, [True, True], None)


@pytest.mark.parametrize(
    ("name", "simulated"), [("SIM", True), ("SIM2", True), ("/link/a/rx:SIMSTATE", True), ("SIMX", False)]
)
def test_simulated_sensors(name: str, simulated: bool) -> None:
    assert sensors_simulated(log_of(table(name, A=[1]))) is simulated


@pytest.mark.parametrize(
    ("ends", "pulses", "commands"),
    [
        (OutputRange(1000, 2000, 1500, False, True), [1000, 1250, 1500, 2000], [-1, -0.5, 0, 1]),
        (OutputRange(1000, 2000, 1500, True, True), [1000, 1250, 1500, 2000], [1, 0.5, 0, -1]),
        (OutputRange(1000, 2000, 1200, False, True), [1000, 1100, 1200, 1600], [-1, -0.5, 0, 0.5]),
        (OutputRange(1000, 2000, 1000, False, True), [900, 1000, 1500], [0, 0, 0.5]),
        (OutputRange(1000, 2000, 2000, True, True), [1000, 1500, 2100], [1, 0.5, 0]),
    ],
)
def test_commands_of_pulses(ends: OutputRange, pulses: list[float], commands: list[float]) -> None:
    assert ends.command(np.array(pulses, dtype=np.float64)) == pytest.approx(commands)


def driven(
    parameters: dict[str, float], *pulses: Any, kind: str = "rover", armed: bool = True
) -> dict[int, OutputChannel]:
    names = {"rover": "ArduRover V4", "copter": "ArduCopter V4", "plane": "ArduPlane V4"}
    rows = len(pulses[0])
    log = log_of(
        table("RCOU", [10 + row for row in range(rows)], **{f"C{channel}": value for channel,
        value in enumerate(pulses, 1)}),
        table("MSG", Message=[names[kind]]), *([table("ARM", [0, 50], ArmState=[1, 0])] if armed else []), END,
    )  # fmt: skip
    return {output.channel: output for output in driven_outputs(log, parameters)}


def test_an_output_by_its_end_points() -> None:
    parameters = {
        "SERVO1_FUNCTION": 73, "SERVO1_MIN": 1000, "SERVO1_MAX": 2000, "SERVO1_TRIM": 1400, "SERVO1_REVERSED": 1,
        "SERVO2_FUNCTION": 0, "SERVO3_FUNCTION": 26, "SERVO3_MIN": 1100, "SERVO3_MAX": 1900, "SERVO3_TRIM": 1500,
    }  # fmt: skip
    found = driven(parameters, [1400, 1700, 3000], [1500] * 3, [1500, 1900, 1300])
    assert list(found) == [1, 3]
    port, rudder = found[1], found[3]
    assert port.name == "output 1 (throttle port)"
    assert (port.function, port.drives, port.known, port.arming_known) == (73, True, True, True)
    np.testing.assert_allclose(port.command, [0.0, -0.5, np.nan])
    assert (rudder.drives, rudder.command.tolist()) == (False, [0.0, 1.0, -0.5])
    assert rudder.armed.tolist() == [True] * 3
    unknown = driven(parameters, [1400] * 3, [1500] * 3, [1500] * 3, armed=False)[1]
    assert (unknown.armed.tolist(), unknown.arming_known) == ([True] * 3, False)


@pytest.mark.parametrize(
    ("pulses", "commands"),
    [
        ([1100, 1500, 1900], [-1.0, 0.0, 1.0]),  # the usual range
        ([1000, 1500, 1900], [-1.0, 0.0, 0.8]),  # a pulse beyond it: the wide one
        ([1100, 1500, 1950], [-0.8, 0.0, 0.9]),
    ],
)
def test_an_output_without_end_points_has_the_usual_ones(pulses: list[float], commands: list[float]) -> None:
    output = driven({"SERVO1_FUNCTION": 73.0}, pulses)[1]
    assert output.known is False
    assert output.command == pytest.approx(commands)


def test_neutral_without_trim_is_the_pulse_at_rest() -> None:
    parameters = {"SERVO1_FUNCTION": 73, "SERVO1_MIN": 1000, "SERVO1_MAX": 2000}
    rows = [1600.0] * 40 + [1300.0, 1300.0, 1400.0]  # disarmed at 50 s, which still counts as armed
    assert driven(parameters, [1600.0, *rows[:40], *rows[40:]])[1].command[0] == pytest.approx(300 / 700)
    near = {**parameters, "SERVO1_TRIM": 1049}
    assert driven(near, [1049.0, 1500.0])[1].command == pytest.approx([0.049, 0.5])  # within 5 % of an end
    away = {**parameters, "SERVO1_TRIM": 1051}
    assert driven(away, [1051.0, 1000.0])[1].command == pytest.approx([0.0, -1.0])


def test_motors_of_a_copter_and_the_throttle_of_a_plane_idle_at_their_least_pulse() -> None:
    copter = {"SERVO1_FUNCTION": 33, "SERVO1_MIN": 900, "SERVO1_MAX": 2100, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000,
              "SERVO1_TRIM": 1500, "SERVO1_REVERSED": 1}  # fmt: skip
    assert driven(copter, [1000.0, 1500.0, 2000.0], kind="copter")[1].command == pytest.approx([0.0, 0.5, 1.0])
    plane = {"SERVO3_FUNCTION": 70, "SERVO3_MIN": 1000, "SERVO3_MAX": 2000, "SERVO3_TRIM": 1500}
    still = [0.0, 0.0, 0.0]
    pulses = [1000.0, 1500.0, 2000.0]
    assert driven(plane, still, still, pulses, kind="plane")[3].command == pytest.approx([0.0, 0.5, 1.0])
    turned = {**plane, "SERVO3_REVERSED": 1}
    assert driven(turned, still, still, pulses, kind="plane")[3].command == pytest.approx([1.0, 0.5, 0.0])
    astern = {**plane, "THR_MIN": -100}
    assert driven(astern, still, still, pulses, kind="plane")[3].command == pytest.approx([-1.0, 0.0, 1.0])


# Missions


def items(at_s: list[float], seqs: list[int], x: list[float], total: list[int] | None = None) -> MadeTable:
    many = len(seqs)
    more = {"CTot": total} if total else {}
    return table("CMD", at_s, CNum=seqs, CId=[16] * many, Lat=x, Lng=[8.0] * many, Alt=[5.0] * many, **more)


def test_each_mission_that_differs_is_a_version() -> None:
    at_s = [1.0, 1.1, 1.2, 5.0, 5.1, 5.2, 9.0, 9.1, 9.2]
    log = log_of(items(at_s, [0, 1, 2] * 3, [40.0, 47.0, 47.1, 41.0, 47.0, 47.1, 41.0, 47.0, 47.2]))
    first, second = mission_versions(log)
    assert (first.at_ns, second.at_ns) == (1 * S, 9 * S)  # home is not compared
    assert [(item.seq, item.latitude_deg, item.longitude_deg, item.altitude_m) for item in first.places] == [
        (1, 47.0, 8.0, 5.0), (2, 47.1, 8.0, 5.0),
    ]  # fmt: skip
    assert list(first.items) == [0, 1, 2]


def test_a_complete_mission_ends_at_its_number_of_items() -> None:
    log = log_of(items([1, 2, 3, 4], [0, 1, 2, 3], [47.0, 47.1, 47.2, 47.3], [2, 2, 4, 4]))
    assert [[*version.items] for version in mission_versions(log)] == [[0, 1], [2, 3]]


def test_rows_that_cannot_be_are_left_out_and_integers_are_scaled() -> None:
    columns = {"seq": [0, 5000, 1, 2, 3], "command": [16, 16, 65_536, 16, 22], "x": [470_000_000.0] * 3 + [np.nan, 0.0],
               "y": [80_000_000.0] * 4 + [0.0], "z": [1.0] * 5, "frame": [3, 0, 0, 0, 6]}  # fmt: skip
    log = log_of(table("MISSION_ITEM_INT", **columns), kind="tlog")
    rows = mission_rows(log)
    assert [(total, item.seq, item.command, item.frame) for _, total, item in rows] == [(0, 0, 16, 3), (0, 3, 22, 6)]
    assert (rows[0][2].latitude_deg, rows[0][2].longitude_deg) == (pytest.approx(47.0), pytest.approx(8.0))
    assert (rows[0][2].place, rows[1][2].place) == (True, False)  # 0, 0 is no place
    assert mission_versions(log_of(END)) == []
