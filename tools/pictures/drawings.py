"""The drawings of the docs: architecture, data flow, what is linked to what."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise

from tools.pictures.drawing import Drawing

GRAPH = {  # Ribeiro et al. 2024, the graph of eq 24
    "D": "PS1 LS LC LA HS HC", "PS1": "LS LC LA HS HA M", "LS": "LC HC M", "LC": "LA HS M", "LA": "M",
    "HS": "HC M", "HC": "HA M", "HA": "M",
}  # fmt: skip
NODES = {
    "D": "driver", "PS1": "simulator", "LS": "sensing", "LC": "control", "LA": "actuation",
    "HS": "sensing", "HC": "control", "HA": "actuation", "M": "monitor",
}  # fmt: skip


def architecture() -> Drawing:
    """The parts of a run and what goes between them."""
    d = Drawing(900, 560, "Architecture of xitl: host, link, agent, companion, recording, readers")
    browser = d.box(45, 20, 280, 50, "Browser", "3D view, pause, wind, debris")
    stations = d.box(575, 20, 280, 50, "Ground stations", "QGroundControl, MAVSDK, …")
    host = d.frame(20, 110, 330, 300, "Host", "blue")
    world = d.box(
        45, 150, 280, 74, "World", "vessel, waves, current, wind", "river, debris, other vessels", tone="blue"
    )
    sensors = d.box(45, 250, 280, 56, "Sensors", "inertial, GNSS, lidar, sonar", tone="blue")
    d.box(45, 336, 280, 50, "Loop", "clock, link counts, faults", tone="blue")
    agent = d.frame(550, 110, 330, 190, "Agent, here or on a board", "green")
    d.box(575, 150, 160, 60, "Autopilot", "ours, ArduPilot, PX4", tone="green")
    d.box(755, 150, 100, 60, "Timing", "tasks, clock", tone="green")
    d.box(575, 230, 280, 52, "DataFlash log", "autopilot.bin", tone="green", mono=True)
    d.box(550, 330, 330, 80, "Companion, here or on a board", "odometry, map, tracks, avoidance", tone="green")
    d.arrow(world.bottom, sensors.top, tone="blue")
    d.arrow((350, 180), (550, 180), label="samples, tick", tone="blue")
    d.arrow((550, 216), (350, 216), label="motor commands", tone="green")
    d.arrow((350, 356), (550, 356), label="clouds, pings", tone="blue")
    d.arrow((550, 390), (350, 390), label="where to go", tone="green")
    d.text(450, 270, "memory, UDP, TCP,", soft=True)
    d.text(450, 290, "serial line, CAN", soft=True)
    d.arrow(browser.bottom, host.at(0.5, 0), both=True, dashed=True)
    d.arrow(stations.bottom, agent.at(0.5, 0), both=True, dashed=True)
    recording = d.box(45, 460, 280, 70, "Recording", "run.mcap, summary.json", tone="amber", mono=True)
    d.arrow((185, 410), recording.top)
    readers = d.box(
        430,
        450,
        450,
        90,
        "xitl logs, view, campaign, paper",
        "findings, reports, 3D replay, boundaries",
        "Foxglove, ROS 2, PlotJuggler",
        tone="amber",
    )
    d.arrow(recording.right, readers.left, tone="amber")
    return d


TECHNIQUES = {
    "MITL": (1, 0, 0, 0, 0, 0), "SITL": (1, 1, 0, 0, 0, 0), "HITL": (1, 1, 1, 0, 0, 0),
    "HuITL": (1, 1, 0, 1, 0, 0), "RITL": (1, 1, 0, 0, 1, 0), "SyITL": (1, 1, 1, 1, 1, 1),
}  # fmt: skip
PARTS = ("control law", "autopilot's code", "its board", "a person", "what sensors see", "boat and water")


def techniques() -> Drawing:
    """Rows of names, columns of what may be real."""
    d = Drawing(900, 410, "What is in the loop: model, software, hardware, human, rendering, system")
    for column, part in enumerate(PARTS):
        d.text(168 + 129 * column, 38, part, bold=True, size=12.5)
    for row, (name, real) in enumerate(TECHNIQUES.items()):
        y = 58 + 50 * row
        d.text(30, y + 25, name, bold=True, anchor="start", size=16)
        for column, is_in in enumerate(real):
            word = "in the loop" if is_in else ("a model" if column in (4, 5) else "–")
            tone = "green" if is_in else "grey"
            d.box(110 + 129 * column, y, 116, 38, "", word, tone=tone, dashed=not is_in)
    d.text(
        30,
        388,
        "HuITL and RITL are added to any of the others: a person may steer a board, too.",
        soft=True,
        anchor="start",
    )
    return d


def node_graph() -> Drawing:
    """The nine nodes with the links of a simulation in which all take part."""
    d = Drawing(900, 485, "The node graph of the paper: driver, simulator, low level, high level, monitor")
    places = {
        "D": (90, 240), "PS1": (450, 440), "M": (810, 240),
        "LS": (290, 320), "LC": (450, 345), "LA": (610, 320),
        "HS": (290, 165), "HC": (450, 125), "HA": (610, 165),
    }  # fmt: skip
    tones = {"D": "amber", "PS1": "blue", "M": "amber"}
    for one, others in GRAPH.items():
        for other in others.split():
            d.line(places[one], places[other])
    for name, (x, y) in places.items():
        tone = tones.get(name, "green" if name[0] == "L" else "red")
        d.circle(x, y, 27, name, tone)
    d.text(450, 82, "high level: companion", soft=True)
    d.text(235, 375, "low level: autopilot", soft=True)
    for name, dx, dy in (("D", 0, 50), ("M", 0, 50), ("PS1", 90, 5)):
        d.text(places[name][0] + dx, places[name][1] + dy, NODES[name], soft=True)
    d.text(30, 40, "24 links between nine nodes", soft=True, anchor="start")
    return d


WDRI_PROFILES = ("mitl", "sitl", "hitl-beaglebone", "sitl-perception", "hitl-full")


def wdri() -> Drawing:
    """What `xitl wdri` says of some shipped profiles."""
    d = Drawing(900, 60 + 52 * len(WDRI_PROFILES), "WDRI of shipped profiles")
    for tick in range(6):
        x = 210 + 126 * tick
        d.line((x, 40), (x, 44 + 52 * len(WDRI_PROFILES)), width=0.6)
        d.text(x, 30, f"{tick / 5:.1f}", soft=True)
    for row, profile in enumerate(WDRI_PROFILES):
        command = [sys.executable, "-m", "xitl_cli.main", "wdri", profile, "--json"]
        told = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        y = 52 + 52 * row
        d.text(198, y + 21, profile, anchor="end", mono=True)
        kinds = [node["kind"] for node in told["nodes"]]
        d.box(210, y, 630 * told["wdri"], 32, tone="blue")
        said = f"{told['wdri']:.2f}: {kinds.count('real')} real, {kinds.count('virtual')} virtual"
        d.text(220 + 630 * told["wdri"], y + 21, said, anchor="start")
    return d


def own_boat() -> Drawing:
    """From init to a run, and back."""
    d = Drawing(900, 190, "The way to a boat of your own")
    steps = [
        ("xitl init", "three files", "that sail at once"),
        ("vessel.yaml", "mass, hull,", "drag, propellers"),
        ("xitl vehicle check", "draft, top speed,", "turning circle"),
        ("xitl sim", "a mission", "on your water"),
        ("xitl logs compare", "beside a log", "of the real boat"),
    ]
    boxes = [
        d.box(24 + 174 * place, 40, 152, 80, *words, tone="amber" if place == 1 else "blue")
        for place, words in enumerate(steps)
    ]
    for one, other in pairwise(boxes):
        d.arrow(one.right, other.left)
    for back in (2, 4):
        x = boxes[back].at(0.5, 1)
        d.arrow(x, (x[0], 160), (boxes[1].bottom[0], 160), boxes[1].bottom, tone="amber")
    d.text(boxes[3].bottom[0], 180, "a figure that is not your boat's", soft=True)
    return d


def ardupilot() -> Drawing:
    """Three ways of the bridge."""
    d = Drawing(900, 380, "Ways of attaching ArduPilot: JSON world, external AHRS, one MAVLink cable with a script")
    d.box(24, 90, 170, 200, "Host", "world and sensors", "mission, recording", tone="blue")
    d.box(320, 90, 170, 200, "Agent", "role: bridge", "here, on the board", "or beside it", tone="green")
    d.arrow((194, 160), (320, 160), label="samples, tick", tone="blue")
    d.arrow((320, 230), (194, 230), label="its outputs", tone="green")
    ways = [
        ("JSON world", "sitl-ardupilot", "true motion, UDP, lockstep"),
        ("external AHRS", "sitl-, hitl-ardupilot-ahrs", "VectorNav, MicroStrain"),
        ("one cable", "hitl-ardupilot-usb", "MAVLink and a Lua script"),
    ]
    d.frame(620, 30, 256, 320, "ArduPilot Rover, unchanged", "amber")
    for place, (name, profile, what) in enumerate(ways):
        y = 64 + 94 * place
        d.box(636, y, 224, 74, name, profile, what, tone="amber")
        d.arrow((490, 130 + 60 * place), (636, y + 37), both=True)
    d.text(405, 330, "MAVLink beside it: parameters, mission, modes", soft=True)
    return d


def px4() -> Drawing:
    d = Drawing(900, 240, "PX4 behind the agent: sensors in, motor outputs back, MAVLink beside it")
    host = d.box(24, 50, 190, 130, "Host", "world and sensors", "recording", tone="blue")
    agent = d.box(350, 50, 190, 130, "Agent", "role: bridge", tone="green")
    px4 = d.box(686, 50, 190, 130, "PX4 v1.16", "differential rover", "EKF2 on our sensors", tone="amber")
    for left, right, sent, got in (
        (host, agent, "samples, tick", "its outputs"),
        (agent, px4, "HIL_SENSOR, …", "motor outputs"),
    ):
        d.arrow(left.at(1, 0.25), right.at(0, 0.25), label=sent, tone="blue")
        d.arrow(right.at(0, 0.6), left.at(1, 0.6), label=got, tone="green")
    d.arrow(agent.at(1, 0.88), px4.at(0, 0.88), both=True)
    d.text(613, 205, "MAVLink: parameters, mission, modes", soft=True)
    return d


def boards() -> Drawing:
    d = Drawing(900, 270, "A host, a board, and the cable between them")
    d.frame(24, 24, 330, 220, "This machine", "blue")
    d.box(48, 64, 282, 60, "xitl sim hitl-beaglebone", "world · sensors · recording", tone="blue")
    d.box(48, 154, 282, 60, "xitl agent deploy", "one file, checked, as a service", tone="grey")
    d.frame(546, 24, 330, 220, "Board: Linux, Python 3.9", "green")
    d.box(570, 64, 282, 60, "xitl-agent.pyz", "autopilot · tasks · clock", tone="green")
    d.box(570, 154, 282, 60, "systemd", "real-time priority, locked memory", tone="grey")
    d.arrow((330, 82), (570, 82), label="sensors", tone="blue")
    d.arrow((570, 112), (330, 112), label="actuators, deadlines, load", tone="green")
    d.arrow((330, 184), (570, 184), label="ssh", above=8)
    d.text(450, 140, "usb0 · Ethernet · serial · CAN", soft=True)
    return d


def virtual_board() -> Drawing:
    art = Drawing(960, 430, "A host, an emulator with ports of this machine on one side, and the board within it")
    art.frame(16, 16, 280, 398, "This machine", "blue")
    art.frame(356, 16, 588, 398, "Emulator of an ARMv7 machine", "amber")
    art.frame(622, 56, 306, 342, "Board: Debian, own kernel and clock", "green")
    art.text(447, 82, "ports of 127.0.0.1", soft=True)
    ways = [
        ("xitl board ssh, agent deploy", "tcp 14700", "sshd, systemd", "22"),
        ("xitl sim: the autopilot's link", "udp, tcp 14701", "agent: autopilot or bridge", "usb0 14660"),
        ("xitl sim: the companion's link", "udp, tcp 14702", "agent: companion", "usb0 14661"),
        ("ground station, xitl params", "tcp 14703", "ArduPilot", "5762"),
        ("xitl sim, a link of serial://", "pseudo-terminal", "agent: a link of serial://", "/dev/ttyS0"),
    ]
    for row, (host, outside, guest, inside) in enumerate(ways):
        y = 98 + 58 * row
        near = art.box(30, y, 252, 44, host, tone="blue")
        port = art.box(372, y, 150, 44, tone="grey")
        art.text(447, y + 27, outside, mono=True)
        far = art.box(638, y, 274, 44, guest, inside, tone="green")
        art.arrow(near.right, port.left, both=True, tone="blue")
        art.arrow(port.right, far.left, both=True, tone="green")
    return art


def links() -> Drawing:
    d = Drawing(900, 330, "One URL opens any transport; urgent messages go first")
    d.box(24, 60, 170, 200, "Host", "XITL_IMU, XITL_GNSS", "XITL_TICK", tone="blue")
    d.box(706, 60, 170, 200, "Agent", "XITL_ACTUATORS", "telemetry", tone="green")
    urls = [
        ("udp://192.168.7.2:14660", "Ethernet, USB"),
        ("tcp://192.168.7.2:14660", "tunnel, firewall"),
        ("serial:///dev/ttyUSB0?baud=921600", "UART, radio"),
        ("can://socketcan/can0?bitrate=1000000", "CAN, CAN FD"),
    ]
    for place, (url, what) in enumerate(urls):
        y = 52 + 54 * place
        box = d.box(238, y, 424, 42, tone="grey")
        d.text(250, y + 26, url, mono=True, anchor="start")
        d.text(650, y + 26, what, soft=True, anchor="end")
        d.arrow((194, box.left[1]), box.left, both=True)
        d.arrow(box.right, (706, box.right[1]), both=True)
    d.text(
        450,
        296,
        "urgent before the rest, bounded queues; every frame sent, received, lost or dropped is counted",
        soft=True,
    )
    return d


def ground_stations() -> Drawing:
    d = Drawing(900, 300, "Ground stations and the ports of the autopilot")
    boat = d.box(350, 90, 200, 120, "Autopilot", "MAVLink 1 and 2", "system 1 … n", tone="green")
    stations = [
        ("QGroundControl", "UDP 14550", 24, 40), ("Mission Planner", "TCP 5760", 24, 128),
        ("MAVProxy", "UDP or TCP", 24, 216),
        ("MAVSDK, pymavlink", "UDP or TCP", 676, 40), ("joystick", "MANUAL_CONTROL", 676, 128),
        ("companion", "GUIDED", 676, 216),
    ]  # fmt: skip
    for name, port, x, y in stations:
        box = d.box(x, y, 200, 52, name, port, tone="blue")
        if x < 300:
            d.arrow(box.right, boat.at(0, (y + 26 - 40) / 228 * 0.8 + 0.1), both=True)
        else:
            d.arrow(box.left, boat.at(1, (y + 26 - 40) / 228 * 0.8 + 0.1), both=True)
    d.text(450, 250, "parameters · missions · fence", soft=True)
    d.text(450, 270, "files · logs · signing", soft=True)
    return d


def ros() -> Drawing:
    art = Drawing(
        860,
        330,
        "A run, the bridge's process with the table of topics, and nodes of ROS; commands come back the same way",
    )
    art.frame(16, 16, 250, 298, "xitl sim", "blue")
    recorder = art.box(36, 56, 210, 70, "what is recorded", "truth, sensors, clouds, links", tone="blue")
    operator = art.box(36, 226, 210, 70, "actions", "checked, recorded, repeatable", tone="blue")
    loop = art.box(36, 146, 210, 60, "the loop", "waits for nothing", tone="grey")
    art.arrow(loop.top, recorder.bottom, tone="blue")
    art.arrow(operator.top, loop.bottom, tone="amber")
    art.frame(336, 16, 200, 298, "node /xitl", "green")
    out = art.box(354, 56, 164, 70, "table of topics", "standard types", tone="green")
    into = art.box(354, 226, 164, 70, "what is asked", "numbers, frames, rates", tone="amber")
    art.text(436, 172, "rclpy · cyclonedds", soft=True)
    art.text(436, 190, "TCPROS (ROS 1)", soft=True)
    art.arrow(recorder.right, out.left, label="queue", tone="blue")
    art.arrow(into.left, operator.right, label="pipe", tone="amber")
    art.frame(620, 16, 224, 298, "your nodes")
    for row, name in enumerate(("/tf  /odometry  /imu/data", "/points  /scan  /fix  …")):
        art.text(732, 82 + 20 * row, name, mono=True)
    art.arrow(out.right, (620, 91), tone="green")
    art.text(732, 146, "rviz2, rosbag2, EKF, Nav2,", soft=True)
    art.text(732, 166, "a node of your own", soft=True)
    for row, name in enumerate(("/cmd_vel  /goal_pose", "thrusters/left/cmd  /arm  …")):
        art.text(732, 256 + 20 * row, name, mono=True)
    art.arrow((620, 261), into.right, tone="amber")
    art.text(740, 222, "/clock, ready: lockstep", soft=True)
    return art


def plugins() -> Drawing:
    art = Drawing(860, 330, "A package, its entry points, and the parts of xitl that load them")
    art.frame(16, 16, 230, 298, "package xitl-radar", "green")
    art.frame(336, 16, 200, 298, "entry points", "amber")
    art.frame(620, 16, 224, 298, "xitl", "blue")
    for row, (part, note, group, user, effect) in enumerate(
        (
            ("NodeKind", "keys, node, topics", "xitl.nodes", "xitl sim", "plugins.radar, /radar/targets"),
            ("analyse(log)", "facts and findings", "xitl.log_analyses", "xitl logs analyze", "a section"),
            ("Command", "a typer function", "xitl.commands", "xitl radar", "a command"),
        )
    ):
        y = 56 + 86 * row
        source = art.box(34, y, 194, 62, part, note, tone="green")
        entry = art.box(350, y, 172, 62, group, "radar = …", tone="amber")
        target = art.box(634, y, 196, 62, user, effect, tone="blue")
        art.arrow(source.right, entry.left, label="registers" if not row else "", tone="green")
        art.arrow(entry.right, target.left, label="loads" if not row else "", tone="blue")
    return art


def recording() -> Drawing:
    d = Drawing(900, 400, "Data flow of a run: what is recorded, where, and who reads it")
    sources = [
        ("World", "/truth/… /environment /scene", "blue"),
        ("Lidar, sonar", "/lidar/points /sonar/…", "blue"),
        ("Autopilot", "/estimate/odometry /actuators", "green"),
        ("Link", "/link/…/tx, rx /links /faults", "grey"),
        ("Agent's time", "/tasks /misses /clocks /nodes", "green"),
    ]
    files = {"run.mcap": 110, "summary.json": 200, "autopilot.bin": 290}
    boxes = {name: d.box(370, y, 170, 54, name, tone="amber") for name, y in files.items()}
    for place, (name, topics, tone) in enumerate(sources):
        box = d.box(24, 24 + 72 * place, 220, 54, name, topics, tone=tone)
        d.arrow(box.right, boxes["run.mcap"].at(0, 0.15 + 0.17 * place))
    d.arrow((244, 195), boxes["autopilot.bin"].left, tone="green")
    d.arrow((244, 268), boxes["summary.json"].left)
    readers = [
        ("xitl logs", "analyze, compare, plot"), ("xitl view", "3D replay, pictures"),
        ("xitl campaign", "tables of many runs"),
        ("Foxglove, ROS 2", "PlotJuggler, your scripts"), ("ground station tools", "any DataFlash reader"),
    ]  # fmt: skip
    for place, (name, what) in enumerate(readers):
        box = d.box(656, 24 + 72 * place, 220, 54, name, what, tone="grey")
        start = boxes[("run.mcap", "run.mcap", "summary.json", "run.mcap", "autopilot.bin")[place]]
        d.arrow(start.right, box.left)
    return d


def profiles() -> Drawing:
    d = Drawing(900, 300, "A profile is composed: later parts win over earlier ones")
    parts = [
        ("bases/base-sitl", "clock, autopilot"), ("sites/santo-antonio", "place, boom, mission"),
        ("vehicles/asv-full", "hull, propellers"), ("environments/…", "current, waves, wind"),
    ]  # fmt: skip
    out = d.box(360, 105, 180, 90, "sitl", "extends them all", tone="blue")
    for place, (name, what) in enumerate(parts):
        box = d.box(24, 22 + 66 * place, 230, 54, name, what, tone="grey")
        d.arrow(box.right, out.at(0, 0.2 + 0.2 * place))
    own = d.box(646, 40, 230, 54, "windy.yaml", "extends: sitl, and its own keys", tone="amber")
    with_ = d.box(646, 123, 230, 54, "--with faults/link-cut", "a part, for this run", tone="amber")
    set_ = d.box(646, 206, 230, 54, "--set a.b=1, --seed 7", "wins over everything", tone="amber")
    for box in (own, with_, set_):
        d.arrow(out.right, box.left)
    return d


def frames() -> Drawing:
    """NED and FRD with their names, and the words for a hull."""
    d = Drawing(900, 330, "Frames and words: north, east, down; forward, right, down")
    d.text(150, 34, "local frame, NED", bold=True)
    origin = (110, 230)
    for end, name in (((110, 80), "north"), ((260, 230), "east")):
        d.arrow(origin, end, tone="blue")
        d.text(end[0] + (0 if name == "north" else 20), end[1] - 10, name, soft=True)
    d.circle(*origin, 6, tone="blue")
    d.text(96, 255, "down, into the page", soft=True, anchor="start")
    d.text(96, 275, "positions _ned_m, origin of the site", soft=True, anchor="start")
    d.text(430, 34, "body, FRD, from above", bold=True)
    hull = "M 400 250 L 400 130 Q 405 90 430 70 Q 455 90 460 130 L 460 250 Z"
    d.path(hull, "grey", filled=True)
    body = (430, 170)
    d.arrow(body, (430, 50), tone="green")
    d.text(470, 60, "forward", soft=True)
    d.arrow(body, (540, 170), tone="green")
    d.text(545, 160, "right", soft=True)
    d.circle(*body, 6, tone="green")
    d.text(350, 275, "roll, pitch, yaw about forward, right, down", soft=True, anchor="start")
    d.path("M 430 120 A 50 50 0 0 1 478 158", "amber")
    d.text(505, 120, "yaw +", soft=True)
    d.text(745, 34, "hull, from astern", bold=True)
    d.line((620, 170), (875, 170), "blue", 1.8)
    d.text(640, 160, "water", soft=True)
    for x in (690, 800):
        d.path(
            f"M {x - 28} 110 L {x - 28} 170 Q {x - 28} 215 {x} 220 Q {x + 28} 215 {x + 28} 170 L {x + 28} 110 Z",
            "grey",
            filled=True,
        )
    d.line((690, 110), (800, 110), "grey", 3)
    d.arrow((845, 170), (845, 220), both=True)
    d.text(872, 200, "draft", soft=True)
    d.arrow((855, 170), (855, 110), both=True)
    d.text(856, 100, "freeboard", soft=True)
    d.text(690, 240, "demi-hull", soft=True)
    d.text(800, 240, "keel", soft=True)
    d.text(745, 275, "a strip is a slice across a hull", soft=True)
    d.text(
        24,
        314,
        "Heading: degrees clockwise from north. Wind comes from, current and waves go to.",
        soft=True,
        anchor="start",
    )
    return d


def vessel_forces() -> Drawing:
    d = Drawing(900, 330, "Forces on a vessel: weight, lift of each strip, drag, thrust, rudder, wind")
    d.path("M 20 205 Q 130 180 240 205 T 460 205 T 680 205 T 880 205", "blue", width=2)
    d.path("M 190 170 L 700 170 Q 690 225 620 245 L 230 245 Q 195 235 190 170 Z", "grey", filled=True)
    d.path("M 330 170 L 350 110 L 520 110 L 545 170 Z", "grey", filled=True)
    for place in range(9):
        x = 235 + 48 * place
        d.line((x, 176), (x, 244), width=0.7)
        d.arrow((x, 290), (x, 250), tone="blue")
    d.text(425, 312, "lift and water's velocity at each strip of each hull, on the wave's surface", soft=True)
    d.arrow((425, 150), (425, 225), tone="red")
    d.text(450, 215, "weight", soft=True, anchor="start")
    d.arrow((190, 232), (90, 232), tone="red")
    d.text(110, 255, "wave drift, current", soft=True)
    d.arrow((90, 140), (200, 215), tone="green")
    d.text(90, 128, "thrust, rudder", soft=True)
    d.arrow((640, 60), (535, 130), tone="amber")
    d.text(700, 55, "wind, by height", soft=True)
    d.arrow((780, 225), (705, 225), tone="red")
    d.text(800, 245, "drag, cross-flow", soft=True)
    d.text(
        24,
        34,
        "(M_RB + M_A) acceleration = all of these at their places, 400 times a second",
        soft=True,
        anchor="start",
    )
    return d
