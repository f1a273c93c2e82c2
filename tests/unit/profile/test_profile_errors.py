"""Every error names file, line, key, value and the fix, in plain words."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from xitl_cli.errors import UserError
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.checks.sensors import divisors_around
from xitl_cli.profile.files.entry import shown

Write = Callable[..., Path]


def _problems(path: Path) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path))
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("environment:\n  wnd: {}", "boat.yaml:2: environment.wnd is not a known key; did you mean 'wind'?"),
        (
            "clock:\n  speed_mps: 3",
            "boat.yaml:2: clock.speed_mps is not a known key; did you mean 'mission.speed_mps' or "
            "'environment.current.speed_mps'?",
        ),
        (
            "recording: {zzz: 1}",
            "boat.yaml:1: recording.zzz is not a known key; known keys: compression, truth_rate_hz, scene, dataflash",
        ),
        (
            "environment:\n  wind:\n    mean_mps: 8 m/s",
            "boat.yaml:3: environment.wind.mean_mps = '8 m/s' is not a number; write a number in m/s",
        ),
        (
            "environment: {wind: {mean_mps: true}}",
            "boat.yaml:1: environment.wind.mean_mps = true is not a number; write a number in m/s",
        ),
        (
            "environment: {wind: {mean_mps: }}",
            "boat.yaml:1: environment.wind.mean_mps = null is not a number; write a number in m/s",
        ),
        (
            "environment: {wind: {mean_mps: .nan}}",
            "boat.yaml:1: environment.wind.mean_mps = nan is not finite; write a finite number in m/s",
        ),
        (
            "environment: {wind: {mean_mps: -1}}",
            "boat.yaml:1: environment.wind.mean_mps = -1 is too small; use a value of at least 0 in m/s",
        ),
        (
            "environment: {water: {density_kgpm3: 0}}",
            "boat.yaml:1: environment.water.density_kgpm3 = 0 is too small; use a value above 0 in kg/m³",
        ),
        (
            "environment: {wind: {direction_deg: 400}}",
            "boat.yaml:1: environment.wind.direction_deg = 400 is too large; use a value of at most 360 in degrees",
        ),
        (
            "recording: {scene: yes}",
            "boat.yaml:1: recording.scene = 'yes' is neither true nor false; write true or false",
        ),
        ("clock: {seed: 1.5}", "boat.yaml:1: clock.seed = 1.5 is not a whole number; write a whole number"),
        ("description: 5", "boat.yaml:1: description = 5 is not text; put it in quotes"),
        (
            "clock:\n  mode: lockstp",
            "boat.yaml:2: clock.mode = 'lockstp' is not one of the choices; "
            "did you mean 'lockstep'? use lockstep or realtime",
        ),
        (
            "technique: flying",
            "boat.yaml:1: technique = 'flying' is not one of the choices; use mitl, sitl, hitl, huitl, ritl or syitl",
        ),
        (
            "clock: fast",
            "boat.yaml:1: clock = 'fast' is not a group; indent keys under it: "
            "mode, physics_rate_hz, exchange_rate_hz, duration_s, seed, on_loss",
        ),
        (
            "mission: {waypoints_ned_m: 5}",
            "boat.yaml:1: mission.waypoints_ned_m = 5 is not a list; write [a, b, ...]",
        ),
        (
            "mission:\n  waypoints_ned_m:\n    - [1, 2]\n    - [1]",
            "boat.yaml:4: mission.waypoints_ned_m.1 = a list of 1 is too short; give every entry, "
            "as in the shipped profiles",
        ),
        (
            "mission:\n  waypoints_ned_m:\n    - [1, 2, 3]",
            "boat.yaml:3: mission.waypoints_ned_m.0 = a list of 3 is too long; give 2",
        ),
        (
            "site:\n  name: here\n  latitude_deg: 1\n  longitude_deg: 2",
            "boat.yaml:1: site needs 'altitude_m'; add it in m",
        ),
        (
            "graph:\n  vertices: all",
            "boat.yaml:2: graph.vertices = 'all' is not a count of vertices; write architecture, present or 1 to 1000",
        ),
        (
            "world: {log_boom: {points_ned_m: [[0, 0, 0]], float_length_m: 1, float_radius_m: 1}}",
            "boat.yaml:1: world.log_boom.points_ned_m = a list of 1 is too short; give at least 2",
        ),
    ],
)
def test_values(write: Write, text: str, problem: str) -> None:
    assert _problems(write(text)) == [problem]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "extends: sitl\nsensors:\n  imu:\n    rate_hz: 333\n",
            "boat.yaml:4: sensors.imu.rate_hz = 333 does not divide the physics rate 400 Hz; use 200 or 400",
        ),
        (
            "clock:\n  exchange_rate_hz: 60",
            "boat.yaml:2: clock.exchange_rate_hz = 60 does not divide the physics rate 400 Hz; use 50 or 80",
        ),
        (
            "extends: sitl\nrecording:\n  truth_rate_hz: 800",
            "boat.yaml:3: recording.truth_rate_hz = 800 is above the physics rate 400 Hz; use 400 or less",
        ),
        (
            "clock: {physics_rate_hz: 300}",
            "boat.yaml:1: clock.physics_rate_hz = 300 has a step of 3333333.333 ns, which is not a whole number; "
            "use 256 or 320",
        ),
        (
            "extends: sitl\nvehicle:\n  mass_kg: 900",
            "boat.yaml:3: vehicle.mass_kg = 900 sinks: the two hulls carry 576.8 kg; "
            "use less mass or a larger vehicle.hull",
        ),
        (
            "extends: sitl\nvehicle:\n  mass_kg: 900\n  hull: null\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0.2], section: {width_m: 1, depth_m: 0.4}}]",
            "boat.yaml:3: vehicle.mass_kg = 900 sinks: its hull carries 798.2 kg; "
            "use less mass or larger vehicle.hulls",
        ),
        (
            "extends: sitl\nvehicle:\n  hull: {keel_below_cg_m: 6}",
            "boat.yaml:3: vehicle.hull.keel_below_cg_m = 6 capsizes at rest: GM_T = -0.732 m, as the weight is 6 m "
            "above the keel and the metacentre 5.27 m; lower the weight by more than 0.732 m, or use wider hulls",
        ),
        (
            "extends: sitl\nvehicle:\n  centre_of_gravity_frd_m: [0, -0.5, 0]",
            "boat.yaml:3: vehicle.centre_of_gravity_frd_m = [0, -0.5, 0] lies with -6.1 deg of heel and 0.0 deg of "
            "trim at rest: the weight is 0.5 m to port of the buoyancy of the level vessel; bring the two together",
        ),
        (
            "extends: sitl\nvehicle:\n  hull: null\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0], mesh: {file: gone.stl, width_m: 1, depth_m: 1}}]",
            "boat.yaml:4: vehicle.hulls.0.mesh.file = {tmp}/gone.stl does not exist; "
            "give the path of a mesh, relative to the profile",
        ),
        (
            "extends: sitl\nvehicle:\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0.2], section: {width_m: 1, depth_m: 0.4}}]",
            "boat.yaml:3: vehicle.hulls and `hull` exclude each other; keep one, `hull: null` drops an inherited one",
        ),
        (
            "extends: sitl\nvehicle: {hull: {width_m: 0.7}}",
            "boat.yaml:2: vehicle.hull.width_m = 0.7 is too narrow for two hulls of radius 0.2 m; use at least 0.8",
        ),
        (
            "extends: sitl\nvehicle: {inertia_kgm2: [10, 20, 64]}",
            "boat.yaml:2: vehicle.inertia_kgm2 = [10, 20, 64] belongs to no body: one moment exceeds the sum of the "
            "other two; lower it to 30 or less",
        ),
        (
            "extends: sitl\nvehicle:\n  derivatives: {Y_r: 20, Y_v: -20}",
            "boat.yaml:3: vehicle.derivatives.Y_v and damping_linear.sway both give it; leave one of them away, "
            "or set damping_linear.sway to 0",
        ),
        (
            "extends: sitl\nvehicle:\n  derivatives: {Y_rdot: -60, N_vdot: -60}",
            "boat.yaml:3: vehicle.derivatives is not positive definite: -N_rdot = 34 has to reach 50 beside the "
            "entries off the diagonal; raise it, make those smaller, or look for a sign",
        ),
        (
            "extends: sitl\nclock: {physics_rate_hz: 800}\nvehicle: {damping_linear: {heave: 1000000}}",
            "boat.yaml:2: clock.physics_rate_hz = 800: the vessel changes its heave at 3039 /s: steps of 1.25 ms do "
            "not follow it; set clock.physics_rate_hz to 3200, or look for a damping too large or a mass too small",
        ),
        (
            "extends: sitl\nautopilot:\n  runs: process\ntechnique: hitl",
            "boat.yaml:2: autopilot.link is missing with autopilot.runs = process; "
            "add one such as udp://127.0.0.1:14660",
        ),
        (
            "extends: hitl-loopback\nautopilot:\n  link: 192.168.7.2",
            "boat.yaml:3: autopilot.link = '192.168.7.2' is not a link; write udp://address:port",
        ),
        (
            "extends: hitl-loopback\nautopilot:\n  link: udp://192.168.7.2:99999",
            "boat.yaml:3: autopilot.link = 'udp://192.168.7.2:99999' has no such port; use a port from 1 to 65535",
        ),
        (
            "extends: sitl\nautopilot:\n  parameter_files: [gone.parm]",
            "boat.yaml:3: autopilot.parameter_files.0: {tmp}/gone.parm does not exist; "
            "check the path, or name a shipped parameter file",
        ),
        (
            "extends: sitl\nautopilot:\n  parameters:\n    WP_SPEED: 1000",
            "boat.yaml:4: autopilot.parameters: WP_SPEED = 1000 is out of range; use 0.1 to 100 m/s",
        ),
        (
            "extends: sitl\nenvironment: {waves: {components: 3}}",
            "boat.yaml:2: environment.waves.components = 3 is too few for an irregular sea; "
            "use 8 or more, or spectrum: regular",
        ),
        (
            "extends: sitl\nenvironment: {wind: {mean_mps: 0, gust: {spectrum: davenport}}}",
            "boat.yaml:2: environment.wind.mean_mps = 0 gives the gust spectrum davenport nothing to scale with; "
            "use a mean above 0, or gust.spectrum: none or ornstein-uhlenbeck",
        ),
        (
            "driver:\n  kind: mission",
            "boat.yaml:2: driver.kind = mission has nothing to drive; add mission.waypoints_ned_m or extend a site",
        ),
        (
            "driver:\n  kind: script",
            "boat.yaml:2: driver.kind = script has no steps; "
            "add driver.script, a list of {at_s: 0, motors: [0.3, 0.3]}",
        ),
        (
            "extends: mitl\ndriver:\n  kind: script\n  script:\n"
            "    - {at_s: 1, motors: [0, 0]}\n    - {at_s: 1, motors: [1, 1]}",
            "boat.yaml:6: driver.script.1.at_s = 1 is not after the step before it (1); put the steps in order of time",
        ),
        (
            "extends: mitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 1, motors: [0]}",
            "boat.yaml:5: driver.script.0.motors = a list of 1 does not fit a vessel with 2 propellers; give 2",
        ),
        (
            "extends: sitl\nvehicle:\n  propellers:\n    - {position_frd_m: [0, 0, 0], max_thrust_n: 9, "
            "max_reverse_thrust_n: 9, spin_up_s: 1, spin_down_s: 1}",
            "boat.yaml:3: vehicle.propellers has 1, but nothing that turns the vessel: give two beside each other, "
            "a bow thruster, a steering gear or a rudder, or use driver.kind: script",
        ),
        (
            "extends: sitl\nvehicle:\n  propellers:\n    - {position_frd_m: [1, 0, 0], angle_deg: 90, max_thrust_n: 9, "
            "max_reverse_thrust_n: 9, spin_up_s: 1, spin_down_s: 1}",
            "boat.yaml:3: vehicle.propellers has none that pushes ahead; "
            "give one an angle_deg of 0, or a steering gear",
        ),
        (
            "extends: sitl\ndriver: {kind: script, script: [{at_s: 0, motors: [0, 0]}]}",
            "boat.yaml:2: driver.script.0.motors goes straight to the vessel, which an autopilot steers; "
            "use mode, arm, rc_us, goto_ned_m, or autopilot.kind: none",
        ),
        (
            "extends: mitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, mode: AUTO}",
            "boat.yaml:5: driver.script.0.mode is an order to an autopilot, and there is none; "
            "use motors, or autopilot.kind: embedded",
        ),
        (
            "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0}",
            "boat.yaml:5: driver.script.0 does nothing; give it mode, arm, rc_us, goto_ned_m or end",
        ),
        (
            "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, end: true}\n    - {at_s: 1, arm: true}",
            "boat.yaml:5: driver.script.0.end ends the run before the steps after it; put it into the last step",
        ),
        (
            "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, rc_us: [1500, 3]}",
            "boat.yaml:5: driver.script.0.rc_us.1 = 3 is no pulse width; use 800 to 2200 µs, "
            "null to leave the channel alone or 0 to give it back",
        ),
        (
            "extends: sitl\ndriver:\n  kind: script\n  script: [{at_s: 0, mode: AUT0}]",
            "boat.yaml:4: driver.script.0.mode = 'AUT0' is not one of the choices; did you mean 'AUTO'? "
            "use MANUAL, ACRO, STEERING, HOLD, LOITER, SIMPLE, "
            "CIRCLE, AUTO, RTL, SMART_RTL or GUIDED",
        ),
        (
            "extends: sitl\ndriver:\n  kind: ground-station",
            "boat.yaml:3: driver.kind = ground-station has nowhere to connect to; use clock.mode: realtime, "
            "or give autopilot.ground_stations a list such as [udp://127.0.0.1:14550]",
        ),
        (
            "extends: mitl\ndriver:\n  kind: ground-station",
            "boat.yaml:3: driver.kind = ground-station has no autopilot to talk to; use autopilot.kind: embedded",
        ),
        (
            "extends: mitl\ndriver:\n  kind: replay",
            "boat.yaml:3: driver.kind = replay has no file; "
            "add driver.file, a log (.bin, .tlog, .mcap, .bag, .db3) or a .csv",
        ),
        (
            "extends: mitl\ndriver: {kind: replay, file: gone.csv}",
            "boat.yaml:2: driver.file: {tmp}/gone.csv does not exist; check the path",
        ),
        (
            "extends: mitl-replay\ndriver: {file: boat.yaml}",
            "boat.yaml:2: driver.file = {tmp_shown} is neither a log (.bin, .tlog, .mcap, a bag) nor a .csv; "
            "give a log with servo outputs or a table of pulse widths",
        ),
        (
            "extends: mitl-replay\ndriver: {replay: {start_s: 5, end_s: 5}}",
            "boat.yaml:2: driver.replay.end_s = 5 is not after start_s (5); use a later end",
        ),
        (
            "extends: mitl-replay\ndriver: {replay: {outputs: [1]}}",
            "boat.yaml:2: driver.replay.outputs = a list of 1 does not fit a vessel with 2 propellers; give 2",
        ),
        (
            "extends: mitl-replay\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2}]\n"
            "driver: {replay: {outputs_are: steering-throttle}}",
            "boat.yaml:4: driver.replay.outputs_are = steering-throttle drives two propellers or one with a gear or "
            "rudders, and the vessel has 2 propellers, 1 rudder; use motors",
        ),
        (
            "extends: [mitl, vehicles/asv-steered]\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2}]\n"
            "driver: {kind: script, script: [{at_s: 0, motors: [0.5, 0.1]}]}",
            "boat.yaml:4: driver.script.0.motors = a list of 2 does not fit a vessel with 1 propeller, 1 steering, "
            "1 rudder; give 3",
        ),
        (
            "extends: mitl\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2, propeller: 3}]",
            "boat.yaml:3: vehicle.rudders.0.propeller = 3 is no propeller; use 0 to 1, or leave it out",
        ),
        (
            "extends: mitl-replay\ndriver: {replay: {rc_channels: [2, 2]}}",
            "boat.yaml:2: driver.replay.rc_channels gives steering and throttle the one channel 2; use two",
        ),
        (
            "extends: sitl\nautopilot:\n  ground_stations:\n    - udp://127.0.0.1:14550\n    - 127.0.0.1",
            "boat.yaml:5: autopilot.ground_stations.1 = '127.0.0.1' is not an address; "
            "write udp://host:port (sent to) or tcp://host:port (listened at)",
        ),
        (
            "extends: sitl\nautopilot:\n  ground_stations: [tcp://0.0.0.0:70000]",
            "boat.yaml:3: autopilot.ground_stations.0 = 'tcp://0.0.0.0:70000' has no such port; "
            "use a port from 1 to 65535",
        ),
        (
            "extends: sitl\nautopilot:\n  ground_stations:\n    - tcp://0.0.0.0:5760\n    - tcp://127.0.0.1:5760",
            "boat.yaml:5: autopilot.ground_stations.1 = 'tcp://127.0.0.1:5760' is there twice, first as number 0; "
            "drop one",
        ),
        (
            "extends: hitl-beaglebone\nautopilot:\n  ground_stations: [udp://127.0.0.1:14550]",
            "boat.yaml:3: autopilot.ground_stations cannot be given to a board from here; "
            "start the agent there with --gcs, once for each address",
        ),
        (
            "extends: sitl\nautopilot:\n  controller: heading",
            "boat.yaml:3: autopilot.controller = 'heading' is not a class; "
            "write package.module:Class or path/to/file.py:Class",
        ),
        (
            "extends: sitl\nautopilot:\n  signing_key_file: key.txt",
            "boat.yaml:3: autopilot.signing_key_file: {tmp}/key.txt: the signing key is missing, there is no such "
            "file; make one for both ends with `(umask 077; openssl rand -hex 32 > {tmp}/key.txt)`, or leave "
            "autopilot.signing_key_file out",
        ),
        (
            "extends: sitl\nautopilot:\n  link_key_file: key.txt",
            "boat.yaml:3: autopilot.link_key_file: {tmp}/key.txt: the signing key is missing, there is no such file; "
            "make one for both ends with `(umask 077; openssl rand -hex 32 > {tmp}/key.txt)`, or leave "
            "autopilot.link_key_file out",
        ),
        (
            "extends: sitl\nautopilot:\n  standby: {runs: in-process}",
            "boat.yaml:3: autopilot.standby has nothing to do in lockstep, where time stands still for an agent that "
            "is silent; use clock.mode: realtime, or leave the standby out",
        ),
        (
            "extends: hitl-loopback\nautopilot:\n  standby: {takeover_s: 0.5}",
            "boat.yaml:3: autopilot.standby.link is missing with runs = process; add one such as udp://127.0.0.1:14661",
        ),
        (
            "extends: hitl-loopback\nautopilot:\n  link: udp://127.0.0.1:14660\n  standby: {link: udp://127.0.0.1:14660}",
            "boat.yaml:4: autopilot.standby.link = 'udp://127.0.0.1:14660' is that of the first agent; "
            "give each its own",
        ),
        (
            "extends: ground-station\nautopilot:\n  standby: {link: udp://127.0.0.1:14661}",
            "boat.yaml:3: autopilot.standby would not get the mission that a ground station gives to the first agent; "
            "use driver.kind: mission, or leave the standby out",
        ),
        (
            "extends: sitl\ntechnique: mitl",
            "boat.yaml:2: technique = mitl has no autopilot; use autopilot.kind: none, or technique: sitl",
        ),
        (
            "extends: mitl\ntechnique: sitl",
            "boat.yaml:2: technique = sitl runs an autopilot on this machine; use technique: mitl",
        ),
        (
            "extends: sitl\ntechnique: hitl",
            "boat.yaml:2: technique = hitl runs autopilot or companion behind a link; "
            "use autopilot.runs: board (or process)",
        ),
        (
            "graph:\n  nodes:\n    LSS: {kind: real}",
            "boat.yaml:3: graph.nodes.LSS is not a node; did you mean 'LS'? "
            "the nodes are D, PS1, LS, LC, LA, HS, HC, HA, M (PS2, PS3, ... for more simulators)",
        ),
        (
            "graph:\n  nodes:\n    PS: {kind: real}",
            "boat.yaml:3: graph.nodes.PS is not a node; number the simulators: PS1, PS2, ...",
        ),
        (
            "graph:\n  nodes:\n    D: {kind: real}\n  links:\n    D: [LC]",
            "boat.yaml:5: graph.links.D: 'LC' is an absent node; drop the link, or give graph.nodes.LC a kind: "
            "real or virtual (and weight: 0 where only its links count)",
        ),
        (
            "graph:\n  nodes:\n    D: {kind: real}\n    M: {kind: real}\n  vertices: 1",
            "boat.yaml:5: graph.vertices = 1 is fewer than the 2 nodes present; use 2 or more",
        ),
        (
            "graph:\n  nodes:\n    D: {kind: absent, weight: 0.5}",
            "boat.yaml:3: graph.nodes.D.weight = 0.5 is given to an absent node; make its kind real or virtual",
        ),
        (
            "graph:\n  reference: eq24",
            "boat.yaml:2: graph.reference = 'eq24': there is no profile 'eq24'; `xitl profiles list` shows all",
        ),
    ],
)
def test_values_that_do_not_go_together(write: Write, tmp_path: Path, text: str, problem: str) -> None:
    said = problem.replace("{tmp_shown}", shown(str(tmp_path / "boat.yaml"))).replace("{tmp}", str(tmp_path))
    assert _problems(write(text)) == [said]


@pytest.mark.parametrize(
    ("rate_hz", "physics_hz", "around"),
    [(333, 400, (200, 400)), (7, 400, (5, 8)), (150, 1000, (125, 200)), (0.3, 400, (400 / 1334, 400 / 1333))],
)
def test_the_rates_offered_are_the_nearest_that_divide(
    rate_hz: float, physics_hz: float, around: tuple[float, float]
) -> None:
    assert divisors_around(rate_hz, physics_hz) == pytest.approx(around, rel=1e-12)


def test_a_fraction_of_a_hertz_may_divide() -> None:
    sensors = load_profile("sitl", ["sensors.gnss.rate_hz=0.5", "sensors.imu.rate_hz=400"]).sensors
    assert sensors is not None
    assert sensors.gnss.rate_hz == 0.5


def test_the_first_problem_is_the_line_and_the_rest_are_counted(write: Write) -> None:
    path = write("environment:\n  wnd: {}\n  wind: {mean_mps: -1}\nclock: {seed: x}\n")
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path), ["recording.scene=1"])
    assert len(caught.value.problems) == 4
    assert str(caught.value) == (
        "boat.yaml:2: environment.wnd is not a known key; did you mean 'wind'? "
        "(and 3 more: run `xitl profiles check boat.yaml --set recording.scene=1`)"
    )


def test_a_misspelt_key_is_not_reported_as_missing_too(write: Write) -> None:
    problems = _problems(write("site:\n  name: here\n  latitude_deg: 1\n  longitud_deg: 2\n  altitude_m: 0\n"))
    assert problems == ["boat.yaml:4: site.longitud_deg is not a known key; did you mean 'longitude_deg'?"]


def test_errors_stay_on_one_line_and_short_whatever_the_value(write: Write) -> None:
    path = write('"a\\nb c": 1\nclock: {mode: "x\\n' + "y" * 500 + '"}\nrecording: {scene: ' + "9" * 300 + "}\n")
    problems = _problems(path)
    assert problems[0].startswith("boat.yaml:1: 'a\\nb c' is not a known key")
    assert all("\n" not in problem and len(problem) < 400 for problem in problems)
    assert len(problems) == 3


def test_huge_numbers_are_refused(write: Write) -> None:
    path = write(f"environment: {{wind: {{mean_mps: {'9' * 390}}}}}\nclock: {{seed: {'9' * 5000}}}\n")
    problems = _problems(path)
    assert problems[0].startswith(
        "boat.yaml:1: environment.wind.mean_mps = an integer of more than 64 bits is not a number"
    )
    assert problems[1].startswith("boat.yaml:2: clock.seed = inf is not a whole number")


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        (
            "eq24-general-use",
            "paper/eq24-general-use: describes a graph only; `xitl wdri paper/eq24-general-use` shows it, a run also "
            "needs technique, site, vehicle, environment, mission, driver, autopilot; "
            "`xitl profiles list` marks those that run",
        ),
        (
            "calm",
            "environments/calm: is a part of a profile; a run also needs technique, site, vehicle, mission, driver, "
            "autopilot; `xitl profiles list` marks those that run",
        ),
    ],
)
def test_what_a_run_lacks(name: str, sentence: str) -> None:
    with pytest.raises(UserError) as caught:
        load_profile(name).runnable()
    assert str(caught.value) == sentence


def test_an_autopilot_needs_sensors(write: Write) -> None:
    write("extends: mitl")
    assert load_profile("boat.yaml").runnable().sensors is None
    write(
        "extends: mitl\ntechnique: sitl\nautopilot: {kind: embedded}\ndriver: {kind: mission}",
    )
    with pytest.raises(UserError, match="a run also needs sensors"):
        load_profile("boat.yaml").runnable()


VALID: dict[str, Any] = yaml.safe_load(resolved_yaml(load_profile("hitl-beaglebone")))
JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.just(10**400),
    st.floats(),
    st.text(max_size=8),
    st.lists(st.one_of(st.integers(), st.text(max_size=3)), max_size=4),
    st.dictionaries(st.text(max_size=4), st.integers(), max_size=2),
)


def _groups(value: Any) -> list[Any]:
    found = [value] if isinstance(value, (dict, list)) else []
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return found + [group for child in children for group in _groups(child)]


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_mutation_loads_or_is_a_user_error_with_its_place(write: Write, data: st.DataObject) -> None:
    profile = copy.deepcopy(VALID)
    for _ in range(data.draw(st.integers(1, 3))):
        group = data.draw(st.sampled_from(_groups(profile)))
        junk = data.draw(JUNK)
        if isinstance(group, list):
            index = data.draw(st.integers(0, len(group)))
            group[index : index + data.draw(st.integers(0, 1))] = [junk]
            continue
        key = data.draw(
            st.one_of(st.sampled_from(sorted(group)), st.text(max_size=6)) if group else st.text(max_size=6)
        )
        if data.draw(st.booleans()):
            group.pop(key, None)
        else:
            group[key] = junk
    path = write(yaml.safe_dump(profile, allow_unicode=True))
    try:
        loaded = load_profile(str(path))
    except ProfileError as error:
        for problem in error.problems:
            assert str(problem).startswith("boat.yaml:")
            assert problem.origin.line is not None
            assert "\n" not in str(problem)
    else:
        assert load_profile(str(write(resolved_yaml(loaded)))) == loaded


def test_a_parameter_file_is_read_when_the_profile_is(write: Write) -> None:
    write("WP_SPEED 3\nWP_SPED 3\n", "tune.parm")
    path = write("extends: sitl\nautopilot:\n  parameter_files:\n    - tune.parm\n")
    (problem,) = _problems(path)
    assert problem.startswith("boat.yaml:4: autopilot.parameter_files.0: ")
    assert "tune.parm:2: WP_SPED is not a parameter" in problem
