"""Recorded motor outputs play again: the same commands at the same instants move the vessel the same way."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl, assert_one_line_error, summary
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray
from pymavlink import DFReader

from tests.recorded import CALM

Array = NDArray[np.float64]


def _decoded(run: Path, topic: str) -> list[tuple[int, object]]:
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(message.log_time, value) for _, _, message, value in reader.iter_decoded_messages(topics=[topic])]


def _positions(run: Path) -> Array:
    return np.array([state.position_ned_m for _, state in _decoded(run, "/truth/state")])  # type: ignore[attr-defined]


def _export(run: Path, table: Path, decimals: int) -> None:
    """The commands of a run as pulse widths, as a servo logger would have written them."""
    rows = ["time_s,C1,C3"]
    for stamp_ns, actuators in _decoded(run, "/actuators"):
        pulses = (1500 + 400 * command for command in actuators.command)  # type: ignore[attr-defined]
        rows.append(",".join([f"{stamp_ns * 1e-9:.3f}", *(f"{pulse:.{decimals}f}" for pulse in pulses)]))
    table.write_text("\n".join(rows) + "\n")


def _commands(run: Path) -> Array:
    return np.array([actuators.command for _, actuators in _decoded(run, "/actuators")])  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_recorded_run_replays_through_a_table_of_pulse_widths(xitl: Xitl, tmp_path: Path) -> None:
    """Commands change at exchanges only, so holding each until the next is exact, and `start_s=0` keeps the clock.

    Unrounded pulses (1e-9 µs) leave the 32-bit floats of the recording, 6e-8 of a command: over 170 m the track has to
    be the same within a millimetre, seven orders above that. Servo loggers keep whole microseconds: every command then
    has to be within half of 1/400 of the recorded one; where that leads an unsteered vessel over minutes is the
    vessel's affair (here some metres), so the track is held to that bound in its first ten seconds only: thrust is
    250 N times the command's square, so at 0.7 it errs by at most 2 · 0.7 · 0.00125 · 250 N = 0.44 N a motor, in the
    worst case always the same way. Ahead that is 0.88 N on 113 kg for 10 s, 0.4 m; across, a moment of 0.44 Nm against
    150 Nm s/rad of damping turns by 3e-3 rad/s, which over 10 s at 3 m/s is 3 · 3e-3 · 10² / 2 = 0.44 m. Together less
    than a metre.
    """
    assert xitl("sim", "--profile", "mitl", "--duration", "60", "--out", "first").returncode == 0
    first, commands = _positions(tmp_path / "first"), _commands(tmp_path / "first")
    assert np.linalg.norm(first[-1] - first[0]) > 100.0
    half_us = 0.5 / 400 + 1e-7
    for decimals, command_bound, seconds, bound_m in ((9, 1e-6, 60, 1e-3), (0, half_us, 10, 1.0)):
        table = tmp_path / f"outputs-{decimals}.csv"
        _export(tmp_path / "first", table, decimals)
        run = f"again-{decimals}"
        replay = ("--profile", "mitl-replay", "--set", f"driver.file={table}", "--set", "driver.replay.start_s=0")
        result = xitl("sim", *replay, "--out", run, "--json")
        assert result.returncode == 0, result.stderr
        told = json.loads(result.stdout)
        assert told["driver"] == {"kind": "replay", "completed": True, "moored_s": 0.0}
        assert told["ended"] == "finished"
        again = _positions(tmp_path / run)
        assert again.shape == first.shape
        assert np.abs(_commands(tmp_path / run) - commands).max() <= command_bound
        assert np.abs(again - first)[: 50 * seconds].max() < bound_m


@pytest.mark.slow
def test_a_replay_that_time_cuts_short_is_not_completed(xitl: Xitl, tmp_path: Path) -> None:
    assert xitl("sim", "--profile", "mitl-replay", "--duration", "5", "--out", "run").returncode == 0
    told = summary(tmp_path / "run")
    assert told["ended"] == "duration reached"
    assert not told["driver"]["completed"]
    assert not told["mission"]["completed"]


@pytest.mark.slow
def test_the_outputs_of_an_ardurover_log_drive_the_vessel(xitl: Xitl, tmp_path: Path) -> None:
    """The log says that output 1 steers and output 3 is the throttle; each holds until the next, 10 times a second.

    Throttle is 0.18 of the span most of the time, which is 2 · 250 N · 0.18² = 16 N on this vessel and 0.6 m/s against
    15 N s/m + 20 N s²/m²: some 20 m in the 40 s between corners alone.
    """
    log = CALM
    (tmp_path / "calm.yaml").write_text("extends: [mitl-replay, environments/calm]\n")
    told = (f"driver.file={log}", "driver.replay.span_us=500")  # SERVO1_MIN to SERVO1_MAX of that log
    result = xitl("sim", "--profile", "calm.yaml", *(word for key in told for word in ("--set", key)), "--out", "run")
    assert result.returncode == 0, result.stderr
    assert summary(tmp_path / "run")["driver"]["completed"]
    reader = DFReader.DFReader_binary(str(log), zero_time_base=True)
    rows = []
    while (message := reader.recv_match(type="RCOU")) is not None:
        rows.append((message.TimeUS, message.C1, message.C3))
    reader.data_map.close()
    reader.filehandle.close()
    at_us, steering, throttle = np.array(rows, dtype=float).T
    steering, throttle = (steering - 1500) / 500, (throttle - 1500) / 500
    mixed = np.stack([throttle + steering, throttle - steering], axis=1)
    mixed /= np.maximum(np.abs(mixed).max(axis=1, keepdims=True), 1.0)
    commands = _decoded(tmp_path / "run", "/actuators")
    assert len(commands) * 0.02 == pytest.approx((at_us[-1] - at_us[0]) * 1e-6, abs=0.03)
    for stamp_ns, actuators in commands:
        in_force = np.searchsorted(at_us - at_us[0], stamp_ns / 1000, side="right") - 1
        assert list(actuators.command) == pytest.approx(mixed[in_force].tolist(), abs=1e-6)  # type: ignore[attr-defined]
    place = _positions(tmp_path / "run")
    assert np.linalg.norm(np.diff(place[:, :2], axis=0), axis=1).sum() > 20.0


@pytest.mark.slow
def test_a_replay_as_rc_goes_through_the_autopilot(xitl: Xitl, tmp_path: Path) -> None:
    """Moored until armed in MANUAL; then the recorded turns show in the motors, port faster to turn to starboard."""
    table = tmp_path / "turns.csv"
    table.write_text("time_s,C1,C3\n0,1700,1700\n5,1800,1600\n10,1600,1800\n15,1500,1500\n")
    arguments = ("--profile", "sitl", "--set", "driver.kind=replay", "--set", f"driver.file={table}")
    result = xitl("sim", *arguments, "--out", "run", "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    moored_s = told["driver"]["moored_s"]
    assert told["driver"]["completed"]
    assert 0.0 < moored_s < 60.0
    assert told["duration_s"] == pytest.approx(moored_s + 15.0, abs=0.05)
    place = _positions(tmp_path / "run")
    held = round(moored_s * 50)
    assert np.ptp(place[: held - 1], axis=0) == pytest.approx(0.0)
    assert np.linalg.norm(place[-1] - place[held]) > 15.0
    motors = {}
    for stamp_ns, actuators in _decoded(tmp_path / "run", "/actuators"):
        motors[round(stamp_ns * 1e-9 - moored_s)] = actuators.command  # type: ignore[attr-defined]
    assert motors[3][0] == motors[3][1] > 0.3
    assert motors[8][0] > motors[8][1] + 0.1
    assert motors[13][1] > motors[13][0] + 0.1


@pytest.mark.slow
def test_a_script_of_orders_arms_and_steers(xitl: Xitl, tmp_path: Path) -> None:
    profile = tmp_path / "boat.yaml"
    profile.write_text(
        "extends: sitl\n"
        "driver:\n"
        "  kind: script\n"
        "  script:\n"
        "    - {at_s: 0, mode: MANUAL, arm: true}\n"
        "    - {at_s: 15, rc_us: [1500, null, 1700]}\n"
        "    - {at_s: 20, mode: GUIDED, goto_ned_m: [60, 60]}\n"
        "    - {at_s: 40, mode: HOLD}\n"
        "    - {at_s: 45, arm: false, end: true}\n"
    )
    result = xitl("sim", "--profile", str(profile), "--out", "run", "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told["driver"]["completed"]
    assert told["duration_s"] == pytest.approx(45.0, abs=1.0)
    place = _positions(tmp_path / "run")
    goal = np.array([60.0, 60.0])
    before, after = (np.linalg.norm(place[round(t * 50), :2] - goal) for t in (20, 40))
    assert after < before - 20.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,C1,C3\n0,1500,1500\n1,15OO,1500\n", ("table.csv:3: column C1: '15OO' is not a number",)),
        ("time_s,C1,C2\n0,1500,1500\n1,1600,1500\n", ("has no output C3", "driver.replay.outputs")),
        ("time_s,C1,C3\n0,1500,1500\n1,1500,1500\n", ("all outputs stay at 1500 µs",)),
    ],
)
@pytest.mark.slow
def test_a_broken_recording_leaves_nothing_behind(
    xitl: Xitl, tmp_path: Path, text: str, words: tuple[str, ...]
) -> None:
    (tmp_path / "table.csv").write_text(text)
    for profile in (("mitl-replay",), ("sitl", "--set", "driver.kind=replay")):
        arguments = ("--profile", *profile, "--set", "driver.file=table.csv", "--out", "run")
        assert_one_line_error(xitl("sim", *arguments), *words)
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]
