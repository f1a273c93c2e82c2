"""Faults of propellers and a rudder against a vessel of two differential equations, whose faults are known."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.recorded_run import recorded_run
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.sections import Finding
from xitl_cli.plugins.logs.analyses.actuation import analyse
from xitl_cli.plugins.logs.analyses.actuator_faults import (
    LEAST_STEERING_GAIN,
    RATE_HZ,
    VesselMotion,
    actuator_faults,
    unanswered_turns,
)

S = 1_000_000_000
DATA = Path(__file__).parents[2] / "data"
END_S, FROM_S, UNTIL_S = 160.0, 60.0, 95.0
SUBSTEPS = 10
Act = Callable[[float, Sequence[float]], Sequence[float]]


def sailed(act: Act, seed: int, *, rudder: bool = False) -> VesselMotion:
    """A vessel that holds 1.5 m/s on changing headings in gusts. act: what the actuators do of (t, commands).

    The loop has plain numbers: numpy takes ten times as long for single values.
    """
    rng = np.random.default_rng(seed)
    dt_s = 1.0 / (RATE_HZ * SUBSTEPS)
    psi = turning = surge = gust = trim = 0.0
    rows = []
    for step in range(round(END_S / dt_s)):
        at_s = step * dt_s
        aim = math.copysign(0.9, math.sin(2 * math.pi * at_s / 31.0))
        trim = clipped(trim + 0.2 * (1.5 - surge) * dt_s, 0.0, 0.5)
        ahead = clipped(0.5 * (1.5 - surge) + trim, -1.0, 1.0)
        aside = clipped(0.8 * (aim - psi) - 1.0 * turning, -0.6, 0.6)
        commands = (aside, ahead) if rudder else (clipped(ahead + aside, -1, 1), clipped(ahead - aside, -1, 1))
        done = act(at_s, commands)
        gust += dt_s * (-0.3 * gust) + 0.02 * math.sqrt(dt_s) * rng.normal()
        if rudder:
            push, moment = 2.0 * done[1] * abs(done[1]), 0.6 * done[0] * surge * abs(surge)
        else:
            port, starboard = (one * abs(one) for one in done)
            push, moment = port + starboard, 0.8 * (port - starboard)
        turning += dt_s * (moment - 1.2 * turning + gust)
        surge += dt_s * (push - 0.3 * surge - 0.2 * surge * abs(surge) + gust)
        psi += dt_s * turning
        if step % SUBSTEPS == 0:
            rows.append((at_s, turning, surge, 0.02 * rng.normal(), psi, *commands))
    table = np.array(rows)
    noisy = table[:, 1:3] + np.array([0.003, 0.02]) * rng.normal(size=(len(table), 2))
    steers = np.array([rudder, False])
    stamp_ns = np.round(table[:, 0] * S).astype(np.int64)
    return VesselMotion(stamp_ns, noisy[:, 0], noisy[:, 1], table[:, 3], table[:, 4], table[:, 5:], steers)


def clipped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def within(at_s: float) -> bool:
    return FROM_S <= at_s < UNTIL_S


def as_commanded(at_s: float, commands: Sequence[float]) -> Sequence[float]:
    return commands


def set_to(output: int, value: float) -> Act:
    def act(at_s: float, commands: Sequence[float]) -> Sequence[float]:
        done = list(commands)
        done[output] = value if within(at_s) else done[output]
        return done

    return act


def scaled(output: int, share: float) -> Act:
    """The thrust of an output times a share; below zero it turns the other way."""

    def act(at_s: float, commands: Sequence[float]) -> Sequence[float]:
        done = list(commands)
        if within(at_s):
            done[output] *= math.copysign(math.sqrt(abs(share)), share)
        return done

    return act


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("kind", "output", "size", "act", "rudder"),
    [
        ("stuck", 0, 0.8, set_to(0, 0.8), False),
        ("thrust_loss", 0, 0.5, scaled(0, 0.5), False),
        ("reversed", 0, 1.0, scaled(0, -1.0), False),
        ("stuck", 0, 0.4, set_to(0, 0.4), True),
    ],
)
def test_a_fault_is_named_with_actuator_onset_end_and_size(
    kind: str, output: int, size: float, act: Act, rudder: bool, seed: int
) -> None:
    (fault,) = actuator_faults(sailed(act, seed, rudder=rudder))
    assert (fault.kind, fault.output) == (kind, output)
    assert fault.from_ns / S == pytest.approx(FROM_S, abs=2.5)
    assert fault.until_ns is not None
    assert fault.until_ns / S == pytest.approx(UNTIL_S, abs=2.5)
    assert fault.size == pytest.approx(size, abs=0.15)


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("rudder", [False, True])
def test_a_vessel_without_a_fault_has_none(rudder: bool, seed: int) -> None:
    motion = sailed(as_commanded, 10 + seed, rudder=rudder)
    assert actuator_faults(motion) == []
    assert unanswered_turns(motion) == []


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_vessel_that_keeps_its_speed_has_a_stuck_rudder_and_no_reversed_propeller(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the response in yaw alone, a reversed propeller explains a rudder near its centre as well."""
    monkeypatch.setitem(globals(), "UNTIL_S", 80.0)
    (fault,) = actuator_faults(sailed(set_to(0, 0.03), seed, rudder=True))
    assert (fault.kind, fault.output) == ("stuck", 0)
    assert fault.from_ns / S == pytest.approx(FROM_S, abs=2.5)
    assert fault.size == pytest.approx(0.03, abs=0.1)


@pytest.mark.medium
@pytest.mark.parametrize("recorded", ["steered-wind-4", "steered-wind-8"])
def test_straight_legs_in_wind_and_current_are_no_stuck_propeller(recorded: str) -> None:
    """Runs of `vehicles/asv-steered` without a fault, with wind of 4 and 8 m/s and a current of 0.8 and 0.4 m/s.

    The models of both improve by over 120 units: with a propeller that is stuck near its command, or reversed.
    """
    rows = np.loadtxt(DATA / "motions" / f"{recorded}.csv", delimiter=",", skiprows=1)
    stamp_ns = np.round((rows[:, 0] + 11.1) * S).astype(np.int64)
    motion = VesselMotion(stamp_ns, *rows.T[1:5], rows[:, 5:], np.array([False, True]))
    assert actuator_faults(motion) == []


@pytest.mark.medium
def test_a_rudder_that_is_stuck_far_from_its_commands_needs_less_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """In rough water the fit improves by 65 units of its variance, where a rudder near its commands needs 100."""
    monkeypatch.setitem(globals(), "UNTIL_S", 75.0)
    calm = sailed(set_to(0, 0.03), 3, rudder=True)
    rough = 0.15 * np.random.default_rng(3).normal(size=len(calm.stamp_ns))
    (fault,) = actuator_faults(replace(calm, yaw_rate_radps=calm.yaw_rate_radps + rough))
    assert (fault.kind, fault.output) == ("stuck", 0)
    assert fault.size == pytest.approx(0.03, abs=0.1)
    assert 55.0 < fault.gain < LEAST_STEERING_GAIN
    during = (calm.stamp_ns > FROM_S * S) & (calm.stamp_ns < 75.0 * S)
    assert np.mean(np.abs(calm.commands[during, 0] - fault.size) > 0.5) > 0.7


def test_a_vessel_that_turns_against_its_commands_did_not_answer_them() -> None:
    """Both propellers are exchanged: no fault of a single one explains it."""
    motion = sailed(lambda at_s, commands: commands[::-1] if within(at_s) else commands, 5)
    (turn,) = unanswered_turns(motion)
    assert turn.from_ns / S == pytest.approx(FROM_S, abs=2.0)
    assert turn.until_ns / S == pytest.approx(UNTIL_S, abs=2.0)
    inside = (motion.stamp_ns >= turn.from_ns) & (motion.stamp_ns <= turn.until_ns)
    assert turn.yaw_rate_radps == pytest.approx(motion.yaw_rate_radps[inside].mean(), rel=0.05)


@pytest.mark.medium
def test_a_propeller_that_is_stuck_at_its_command_has_an_uncertain_onset() -> None:
    """It shows from the first change of the command on; the earliest onset is not later than the true one."""

    def act(at_s: float, commands: Sequence[float]) -> Sequence[float]:
        return (0.5, commands[1]) if within(at_s) else commands

    calm = sailed(act, 6)
    (fault,) = actuator_faults(calm)
    earliest_ns, latest_ns = fault.began_ns or (fault.from_ns, fault.from_ns)
    assert earliest_ns - 2.5 * S <= FROM_S * S <= latest_ns + 2.5 * S


@pytest.mark.medium
@pytest.mark.parametrize(
    ("recorded", "steers", "output", "at_s"),
    [("stuck-propeller", [False, False], 1, 27.0), ("jammed-steering", [True, False], 0, 26.8)],
)
def test_an_actuator_that_kept_its_command_is_stuck(
    recorded: str, steers: list[bool], output: int, at_s: float
) -> None:
    """Lost thrust, or a reversed propeller, explains the motion nearly as well, but with a size that is no accident.

    From simulated runs; the commands are at the ends of their ranges during most of the fault.
    """
    rows = np.loadtxt(DATA / "motions" / f"{recorded}.csv", delimiter=",", skiprows=1)
    stamp_ns = np.round((rows[:, 0] + 11.1) * S).astype(np.int64)
    (fault,) = actuator_faults(VesselMotion(stamp_ns, *rows.T[1:5], rows[:, 5:], np.array(steers)))
    assert (fault.kind, fault.output) == ("stuck", output)
    assert fault.from_ns / S == pytest.approx(at_s, abs=1.0)


@pytest.mark.medium
def test_a_vessel_that_the_wind_holds_from_its_start_has_no_fault() -> None:
    """In a wind of 24 m/s, the start differs from the motion after it like a propeller that lost a third."""
    rows = np.loadtxt(DATA / "motions" / "strong-wind.csv", delimiter=",", skiprows=1)
    stamp_ns = np.round(rows[:, 0] * S).astype(np.int64)
    motion = VesselMotion(stamp_ns, *rows.T[1:5], rows[:, 5:], np.array([False, False]))
    assert actuator_faults(motion) == []


@pytest.mark.medium
def test_a_small_loss_is_below_the_floor() -> None:
    assert actuator_faults(sailed(scaled(0, 0.95), 3)) == []


def run_findings(folder: Path, extends: str, fault: str, *overrides: str) -> list[Finding]:
    """What the autopilot's log of a run tells of its actuators; the fault lasts from 60 to 100 s."""
    profile = folder / "faulty.yaml"
    fault = f"{{from_s: 60.0, until_s: 100.0, propeller: {{{fault}}}}}" if fault else ""
    profile.write_text(
        f"extends: {extends}\ndescription: A faulty boat\nfaults: {{{f'f: {fault}' if fault else ''}}}\n"
    )
    with DataFlashLog(recorded_run(str(profile), 130.0, *overrides) / "autopilot.bin") as log:
        section = analyse(log)
    return [] if section is None else list(section.findings)


@pytest.mark.nightly
@pytest.mark.slow
def test_lost_thrust_of_a_run_is_named_with_propeller_onset_end_and_share(tmp_path: Path) -> None:
    (found,) = run_findings(tmp_path, "[sitl, vehicles/heron]", "which: starboard, thrust_loss: 0.5", "clock.seed=402")
    # The commands vary too little to exclude a stuck propeller, so the finding may give both.
    assert found.key in ("actuation.thrust_loss", "actuation.stuck")
    assert "output 3 (throttle starboard)" in found.sentence
    lost = re.search(r"lost (\d+) % of its thrust", found.sentence)
    assert lost is not None
    assert float(lost[1]) == pytest.approx(50.0, abs=20.0)
    evidence = found.evidence[0]
    assert (evidence.at_ns or 0) / S == pytest.approx(60.0, abs=3.0)
    assert (evidence.until_ns or 0) / S == pytest.approx(100.0, abs=3.0)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_run_without_a_fault_has_none(tmp_path: Path) -> None:
    assert run_findings(tmp_path, "[sitl, vehicles/heron]", "", "clock.seed=403") == []
