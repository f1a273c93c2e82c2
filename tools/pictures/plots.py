"""Plots of runs and models, on white, so that they are legible on any page."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import xitl
from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water, WaveSpec
from sim_core.environment.tide import make_tide
from sim_core.environment.waves import WaveField, jonswap, realise_waves
from sim_core.frames import matrix_to_euler
from sim_core.simulation import Simulation, initial, step
from tests.oracles import mariner
from tests.oracles.kvlcc2 import Kvlcc2, ZigZag
from tools.pictures.browser import fewer_colours
from tools.pictures.workplace import Workplace
from xitl_cli.logs import open_log
from xitl_cli.plugins.studies.manoeuvres.ship_trials import ship_trials
from xitl_cli.run.world.colours import PAINTS
from xitl_cli.run.world.vessel_shape import drawn_diameter_m, propeller_mesh, vessel_parts

INK, BLUE, AMBER, GREEN, RED, GREY = "#1c2733", "#2f6fc4", "#b97a10", "#23834a", "#c23b33", "#8a97a5"
VESSELS = ("wamv16", "asv-full", "otter", "heron", "cybership2", "blueboat", "asv-third")
CONVOY = "xitl sim fleet-convoy --duration 150 --out runs/convoy"
EXCITATION = "xitl sim identify-excitation --out runs/excitation"
CUT = "xitl sim cut.yaml --out runs/cut"
RADAR = "xitl sim sitl-radar --duration 60 --out runs/radar"
RIVER = "xitl sim sitl-perception --duration 130 --out runs/river"


def figure(path: Path, draw: Callable[[Any], None], width: float = 9.2, height: float = 4.2, panels: int = 1) -> None:
    """draw: of one Axes, or of an array of panels beside each other."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
                         "grid.color": "#e3e8ed", "axes.edgecolor": GREY, "text.color": INK}):  # fmt: skip
        drawn, axes = plt.subplots(1, panels, figsize=(width, height), layout="constrained")
        draw(axes)
        drawn.savefig(path, dpi=110, facecolor="white")
        plt.close(drawn)
    fewer_colours(path)


def vehicles(workplace: Workplace, path: Path) -> None:
    """The shipped boats as xitl draws them, from the quarter, to one scale."""
    from matplotlib.collections import PolyCollection

    # An orthographic camera: directions of its picture in the vessel's axes (forward, right, down)
    turn, rise = np.radians(150.0), np.radians(24.0)
    across = np.array([np.sin(turn), -np.cos(turn), 0.0])
    towards = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), -np.sin(rise)])
    up = np.cross(towards, across)
    up = up if up[2] < 0.0 else -up
    light = np.array([-0.35, 0.45, -0.82])

    def draw(axes: Any) -> None:
        begin = 0.0
        for name in VESSELS:
            page = workplace.file(f"{name}.yaml", f"extends: [sitl, vehicles/{name}, environments/calm]\n")
            profile = xitl.load_profile(page)
            vehicle = profile.vehicle
            corners, colours = [], []
            for part in vessel_parts(vehicle, profile.environment.water):
                triangles = part.mesh.vertices_m[part.mesh.faces]
                normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
                normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
                corners.append(triangles)
                shade = 0.55 + 0.45 * np.clip(normal @ light, 0.0, 1.0)
                colours.append(shade[:, None] * np.asarray(PAINTS[part.paint][:3]))
            for propeller in vehicle.propellers:
                mesh = propeller_mesh(drawn_diameter_m(propeller, vehicle.length_m))
                triangles = mesh.vertices_m[mesh.faces] + np.asarray(propeller.position_frd_m)
                corners.append(triangles)
                colours.append(np.full((len(triangles), 3), 0.25))
            triangles, shades = np.concatenate(corners), np.concatenate(colours)
            order = np.argsort(triangles.mean(axis=1) @ towards)
            plan = np.stack([triangles @ across, triangles @ up], axis=-1)[order]
            left, right = plan[..., 0].min(), plan[..., 0].max()
            plan[..., 0] += begin - left
            colour = shades[order]
            axes.add_collection(PolyCollection(list(plan), facecolor=colour, edgecolor=colour, linewidth=0.2))
            middle = begin + 0.5 * (right - left)
            axes.text(middle, plan[..., 1].min() - 0.2, name, ha="center", va="top")
            begin += max(right - left, 1.0) + 0.5
        axes.set(xlim=(-0.3, begin), ylim=(-1.9, 2.2), aspect="equal")
        axes.set_axis_off()
        axes.plot([begin - 1.5, begin - 0.5], [-1.6, -1.6], color=INK, linewidth=2.0)
        axes.text(begin - 1.0, -1.55, "1 m", ha="center", va="bottom")

    figure(path, draw, width=11.5, height=3.8)


def manoeuvres(workplace: Workplace, path: Path) -> None:
    """Turning circle and zig-zags of ships with published tables, beside their sources' equations and figures."""
    ships = {name: xitl.load_profile(f"vehicles/{name}").vehicle for name in ("kvlcc2-l7", "mariner")}
    plots = {name: {plot.key: plot for plot in ship_trials(ship, name).plots} for name, ship in ships.items()}
    tanker = Kvlcc2(resistance=0.0157, gyration=0.24)
    circle = tanker.sail(1.179, 10.4, lambda _turned: 35.0, 160.0, 0.1)
    zig_zags = {
        "kvlcc2-l7": (tanker.sail(1.179, 10.4, ZigZag(20.0), 80.0, 0.02), 0.02),
        "mariner": (mariner.sail(ZigZag(20.0), 300.0, 0.1), 0.1),
    }

    def draw(axes: Any) -> None:
        chart, *panels = axes
        own = plots["kvlcc2-l7"]["ship_turning"].traces[0]
        chart.plot(own.x, own.y, color=BLUE, label="xitl")
        chart.plot(
            circle[::40, 4] / 7, circle[::40, 3] / 7, ".", color=INK, markersize=4, label="equations of the paper"
        )
        for (advance, tactical), marker, name in (
            ((3.31, 3.36), "x", "its simulation: advance, tactical diameter"),
            ((3.25, 3.34), "s", "free run of MARIN"),
        ):
            chart.axhline(advance, 0.0, 0.45, color=GREY, linewidth=0.6)
            chart.plot([0.1, tactical], [advance, 0.0], marker, color=RED, markersize=6, fillstyle="none", label=name)
        chart.set(
            xlabel="east (lengths)",
            ylabel="north (lengths)",
            title="KVLCC2 L7, 35°",
            aspect="equal",
            xlim=(-0.3, 4.3),
            ylim=(-1.6, 4),
        )
        chart.legend(fontsize=7, loc="lower left")
        for panel, (name, (states, step_s)) in zip(panels, zig_zags.items(), strict=True):
            heading = plots[name]["ship_zig_zag_20"].traces[0]
            shown = heading.x <= len(states) * step_s
            panel.plot(heading.x[shown], heading.y[shown], color=BLUE)
            time_s = np.arange(len(states)) * step_s
            panel.plot(time_s[::100], np.degrees(states[::100, 5]), ".", color=INK, markersize=4)
            panel.step(time_s, np.degrees(states[:, 6]), color=AMBER, linewidth=0.8)
            panel.set(xlabel="time (s)", ylabel="heading, rudder (°)", title=f"{name}, zig-zag 20/20")

    figure(path, draw, width=11.0, height=4.2, panels=3)


def seas(workplace: Workplace, path: Path) -> None:
    """A JONSWAP sea and its spectrum."""
    spec = WaveSpec(spectrum="jonswap", significant_height_m=0.3, peak_period_s=3.0, direction_deg=60.0)
    water = Water(depth_m=12.0)
    field = realise_waves(spec, water, np.random.default_rng(1))
    assert isinstance(field, WaveField)
    side_m = np.linspace(0.0, 80.0, 240)
    places = np.stack(np.meshgrid(side_m, side_m, indexing="ij"), axis=-1).reshape(-1, 2)
    elevation_m = np.concatenate([field.elevation_m(0.0, some) for some in np.array_split(places, 40)])

    def draw(axes: Any) -> None:
        chart, spectrum = axes
        drawn = chart.imshow(
            elevation_m.reshape(len(side_m), -1), origin="lower", extent=(0, 80, 0, 80), cmap="Blues_r"
        )
        chart.figure.colorbar(drawn, ax=chart, label="elevation (m)")
        chart.set(xlabel="east (m)", ylabel="north (m)", title="The surface at one instant")
        chart.grid(False)
        omega_radps = np.linspace(1.0, 6.0, 300)
        spectrum.plot(omega_radps, jonswap(omega_radps, 0.3, 3.0), color=BLUE, label="JONSWAP")
        spectrum.vlines(
            field.omega_radps,
            0,
            jonswap(field.omega_radps, 0.3, 3.0),
            color=AMBER,
            alpha=0.6,
            linewidth=0.9,
            label="its components",
        )
        spectrum.set(
            xlabel="angular frequency (rad/s)", ylabel="m² s/rad", title="Its spectrum, Hs 0.3 m, Tp 3 s", xlim=(1, 6)
        )
        spectrum.legend()

    figure(path, draw, panels=2)


def seakeeping(workplace: Workplace, path: Path) -> None:
    """Motions and mean drift of twin hulls, with and without tables of a panel code, against that code."""
    folder = Path(__file__).parents[2] / "tests/data/capytaine"
    reference = json.loads((folder / "reference.json").read_text(encoding="utf-8"))
    period_s, hull = np.array(reference["periods_s"]), reference["hulls"]["twin-hulls"]
    model = xitl.load_profile(str(folder / "twin-hulls.yaml")).vehicle
    known_m = np.array(hull["heave_roll_pitch"])
    known_n = np.column_stack([np.array(hull["drift_right_n"])[:, 1], -np.array(hull["drift_ahead_n"])[:, 2]])
    fine_s = np.geomspace(0.7, 2.5, 45)
    runs = {
        name: [_in_regular_waves(vessel, float(each)) for each in fine_s]
        for name, vessel in (("with tables", model), ("without", replace(model, hydrodynamics_file=None)))
    }
    colours = {"with tables": BLUE, "without": AMBER}
    total_n = 0.5 * 997.8 * 9.80665 * model.length_m

    def draw(axes: Any) -> None:
        heave, turns, drift = axes
        for name, simulated in runs.items():
            moved = np.array([motion for motion, _ in simulated])
            pushed = np.array([force for _, force in simulated])
            for chart, row, column, line in (
                (heave, 0, 0, "-"),
                (heave, 1, 0, "--"),
                (turns, 0, 1, "-"),
                (turns, 1, 2, "--"),
            ):
                chart.plot(fine_s, moved[:, row, column], line, color=colours[name], linewidth=1.4)
            for row, line in ((0, "-"), (1, "--")):
                drift.semilogy(fine_s, pushed[:, row], line, color=colours[name], linewidth=1.4)
        for chart, row, column, mark in (
            (heave, 1, 0, "o"),
            (heave, 2, 0, "s"),
            (turns, 1, 1, "o"),
            (turns, 2, 2, "s"),
        ):
            chart.plot(period_s, known_m[:, row, column], mark, color=INK, markersize=4, fillstyle="none")
        for row, mark in ((0, "o"), (1, "s")):
            drift.semilogy(period_s, known_n[:, row], mark, color=INK, markersize=4, fillstyle="none")
        drift.axhline(total_n, color=RED, linewidth=1.0)
        drift.text(2.5, 1.25 * total_n, "total reflection, beam", color=RED, ha="right", fontsize=8)
        heave.set(xlabel="period (s)", title="Heave (m/m)")
        turns.set(xlabel="period (s)", title="Roll in beam, pitch in head seas (rad/m)")
        drift.set(xlabel="period (s)", title="Mean drift (N/m²)", ylim=(1e-1, 4e4))
        lines = [heave.plot([], [], color=colour, label=f"simulation {name}")[0] for name, colour in colours.items()]
        marks = [
            heave.plot([], [], mark + line, color=INK, markersize=4, fillstyle="none", linewidth=1.0, label=label)[0]
            for mark, line, label in (("o", "-", "Capytaine, beam"), ("s", "--", "Capytaine, head"))
        ]
        heave.legend(handles=[*lines, *marks], fontsize=8)

    figure(path, draw, width=13.0, panels=3)


def _in_regular_waves(model: Any, period_s: float) -> tuple[Any, Any]:
    """Heave, roll and pitch per metre of waves, (2, 3), and drift along the waves, (2,): in beam and in head seas."""
    water = Water(level_m=0.0, depth_m=200.0)
    waves = realise_waves(WaveSpec("regular", 0.002, period_s), water, np.random.default_rng(0))
    simulation = Simulation.from_spec(model, Environment(water=water, waves=waves), 0.01)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((2, 2)), np.radians([-90.0, 180.0]), rng)
    seen, times, forces = [], [], []
    for _ in range(round((25.0 + 10.0 * period_s) / 0.01)):
        state = step(simulation, state, np.zeros((1, model.commands)), rng)
        if state.time_ns > 25 * 10**9:
            motion = state.vessel.motion
            seen.append(np.column_stack([motion.pos_ned_m[:, 2:], matrix_to_euler(motion.rot_ned_frd)[:, :2]]).ravel())
            times.append(2.0 * np.pi / period_s * state.time_ns * 1e-9)
            forces.append(np.vecdot(motion.rot_ned_frd[:, 0, :2], state.drift_frd_n))
    basis = np.column_stack([np.cos(times), np.sin(times), np.ones(len(times))])
    fitted = np.linalg.lstsq(basis, np.array(seen), rcond=None)[0]
    return np.hypot(fitted[0], fitted[1]).reshape(2, 3) / 0.001, np.mean(forces, axis=0) / 0.001**2


def tide(workplace: Workplace, path: Path) -> None:
    """Level and stream of the profile of docs/seas.md over 12 hours."""
    page = (Path(__file__).parents[2] / "docs/seas.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```yaml\n# harbour\.yaml\n(.*?)```", page, re.DOTALL)
    environment = xitl.load_profile(workplace.file("harbour.yaml", text)).environment
    moving = make_tide(environment)
    time_s = np.linspace(0.0, 12 * 3600.0, 600)
    level_m = [environment.water.level_m + moving.height_m(each) for each in time_s]
    stream_mps = [moving.stream_mps(each) for each in time_s]

    def draw(axes: Any) -> None:
        axes.plot(time_s / 3600.0, level_m, color=BLUE)
        axes.set(xlim=(0, 12), xticks=range(0, 13, 2), xlabel="hours since the start")
        axes.set_ylabel("level of the water (m)", color=BLUE)
        along = axes.twinx()
        along.plot(time_s / 3600.0, stream_mps, color=AMBER)
        along.axhline(0.0, color=GREY, linewidth=0.8)
        along.set_ylabel("stream, flood positive (m/s)", color=AMBER)
        along.grid(False)

    figure(path, draw)


def position_error(recording: Path) -> tuple[Any, Any]:
    """Time in s and how far the estimate is from the truth, level, in m."""
    with xitl.open_log(recording) as log:
        truth, estimate = log["/truth/odometry"], log["/estimate/odometry"]
        time_s = estimate.stamp_ns * 1e-9
        off_m = [
            estimate[place] - np.interp(time_s, truth.stamp_ns * 1e-9, truth[place])
            for place in ("pose.pose.position.x", "pose.pose.position.y")
        ]
    return time_s, np.hypot(*off_m)


def faults(workplace: Workplace, path: Path) -> None:
    """The estimate in a run whose link is cut for five seconds, beside the same run without."""
    workplace.file("cut.yaml", "extends: [sitl, faults/link-cut]\n")
    workplace.typed("xitl sim sitl --out runs/first")
    workplace.typed(CUT)
    runs = {name: position_error(workplace.folder / f"runs/{name}/run.mcap") for name in ("first", "cut")}

    def draw(axes: Any) -> None:
        axes.axvspan(40, 45, color="#fbdedd", label="no frame on the link")
        axes.plot(*runs["first"], color=GREY, label="sitl")
        axes.plot(*runs["cut"], color=RED, label="sitl with faults/link-cut")
        axes.set(xlim=(20, 90), ylim=(0, None), xlabel="simulation time (s)", ylabel="estimate off by (m)")
        axes.legend()

    figure(path, draw, height=3.4)


def fleet(workplace: Workplace, path: Path) -> None:
    """The convoy from above."""
    workplace.typed(CONVOY)
    with xitl.open_log(workplace.folder / "runs/convoy/run.mcap") as log:
        names = sorted(name.split("/")[1] for name in log.tables if name.endswith("/truth/state"))
        tracks = {name: log[f"/{name}/truth/state"]["position_ned_m"] for name in names}

    def draw(axes: Any) -> None:
        for name, colour in zip(names, (GREEN, AMBER, RED, BLUE), strict=False):
            track = tracks[name]
            axes.plot(track[:, 1], track[:, 0], color=colour, linewidth=1.2, label=name)
            axes.plot(
                track[:: max(1, len(track) // 6), 1],
                track[:: max(1, len(track) // 6), 0],
                "o",
                color=colour,
                markersize=4,
            )
        axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="fleet-convoy: places at seven instants")
        axes.legend()

    figure(path, draw, height=5.0)


def perception(workplace: Workplace, path: Path) -> None:
    """The map that the companion has made, from above."""
    import trimesh

    workplace.typed(RIVER)
    points_m = np.asarray(trimesh.load(workplace.folder / "runs/river/map.ply").vertices)
    track_m = np.loadtxt(workplace.folder / "runs/river/trajectory.tum")[:, 1:4]

    def draw(axes: Any) -> None:
        drawn = axes.scatter(points_m[:, 0], points_m[:, 1], c=points_m[:, 2], s=0.4, cmap="viridis", vmin=-4, vmax=6)
        axes.plot(track_m[:, 0], track_m[:, 1], color=RED, linewidth=1.2, label="way of the vessel, by its odometry")
        axes.set(
            xlabel="m", ylabel="m", aspect="equal", title="The companion's map of sitl-perception, from lidar and sonar"
        )
        axes.figure.colorbar(drawn, ax=axes, label="height (m)")
        axes.legend()

    figure(path, draw, height=3.2)


def radar(workplace: Workplace, path: Path) -> None:
    """Echoes and plots of a turn, north up."""
    workplace.typed(RADAR)
    turn = 16
    with open_log(workplace.folder / "runs/radar/run.mcap") as log:
        sectors, plots = log.tables["/marine_radar/sector"], log.tables["/marine_radar/plots"]
        rows = np.flatnonzero(sectors.values("turn") == turn)
        spokes, bins = int(sectors.values("spokes")[0]), int(sectors.values("bins")[0])
        images = [np.frombuffer(bytes(sectors.values("intensity")[row]), np.uint8) for row in rows]
        image = np.concatenate(images).reshape(-1, bins)
        first_rad = sectors.values("heading_rad")[rows] + sectors.values("angle_start_rad")[rows]
        step_rad = float(sectors.values("angle_increment_rad")[0])
        own = plots.values("turn") == turn
        range_m, bearing_rad = plots.values("range_m")[own], plots.values("true_bearing_rad")[own]
        farthest_m = float(sectors.values("range_max_m")[0])
        heading_rad = float(sectors.values("heading_rad")[rows[len(rows) // 2]])

    def draw(axes: Any) -> None:
        azimuth = (first_rad[:, None] + (np.arange(spokes) - 0.5) * step_rad).ravel()
        edges = np.append(azimuth, azimuth[-1] + step_rad)
        ranges_m = np.linspace(0.0, farthest_m, bins + 1)
        north_m, east_m = np.cos(edges)[:, None] * ranges_m, np.sin(edges)[:, None] * ranges_m
        drawn = axes.pcolormesh(east_m, north_m, image / 255.0 * 80.0, cmap="viridis", rasterized=True)
        axes.scatter(np.sin(bearing_rad) * range_m, np.cos(bearing_rad) * range_m, s=28, facecolors="none",
                     edgecolors=RED, linewidths=1.1, label="plots")  # fmt: skip
        reach_m = 0.1 * farthest_m
        axes.plot([0.0, math.sin(heading_rad) * reach_m], [0.0, math.cos(heading_rad) * reach_m], color="white",
                  linewidth=1.5)  # fmt: skip
        axes.set(xlabel="east of the vessel (m)", ylabel="north of the vessel (m)", aspect="equal",
                 title="One turn of the radar of sitl-radar")  # fmt: skip
        axes.grid(visible=False)
        axes.figure.colorbar(drawn, ax=axes, label="level above the noise (dB)")
        axes.legend(loc="upper left")

    figure(path, draw, width=7.6, height=6.4)


def documented(page: str, name: str) -> str:
    """The text of a file that a page of docs/ shows."""
    text = (Path(__file__).parents[2] / "docs" / page).read_text(encoding="utf-8")
    found = re.search(rf"^```yaml\n(# {re.escape(name)}\n.*?)^```$", text, re.MULTILINE | re.DOTALL)
    if found is None:
        raise LookupError(f"docs/{page} shows no {name}")
    return found[1]


def own_site(workplace: Workplace, path: Path) -> None:
    """The chart of the reach that docs/own-site.md makes."""
    from matplotlib.collections import PolyCollection

    from xitl_cli.scenery import Scenery

    profile = xitl.load_profile(workplace.file("reach.yaml", documented("own-site.md", "reach.yaml")))
    scenery = Scenery(profile)
    north_m, east_m = np.linspace(-75, 75, 151), np.linspace(-80, 160, 241)
    places = np.stack(np.meshgrid(north_m, east_m, indexing="ij"), axis=-1).reshape(-1, 2)
    down_m = scenery.bed.bed_down_m(places).reshape(len(north_m), -1)
    colours = {"wood": "#8a6a43", "leaves": "#5f8f4e", "rock": "#6f7780", "wall": "#b9a48a", "plastic": RED}

    def draw(axes: Any) -> None:
        chart = axes.contourf(east_m, north_m, down_m, levels=[0, 1, 2, 3, 4, 5, 6], cmap="Blues", extend="max")
        axes.set_facecolor("#d8d2b4")
        axes.figure.colorbar(chart, ax=axes, label="depth (m)")
        for part in scenery.scene.parts:
            plan = part.mesh.vertices_m[part.mesh.faces][..., [1, 0]]
            colour = colours.get(part.mesh.material.name)
            if colour and part.name != "ground":
                axes.add_collection(PolyCollection(list(plan), facecolor=colour, edgecolor=colour, linewidth=0.3))
        start = profile.mission.start
        way = np.array([(start.north_m, start.east_m), *profile.mission.waypoints_ned_m])
        axes.plot(way[:, 1], way[:, 0], "o--", color=INK, markersize=4, linewidth=1.2, label="mission")
        for launch in profile.world.debris.launches:
            north, east = launch.pos_ned_m
            axes.plot(east, north, "x", color=RED, markersize=8, label=f"{launch.kind} at {launch.at_s:g} s")
        axes.set(xlim=(-80, 160), ylim=(-75, 75), xlabel="east (m)", ylabel="north (m)", aspect="equal")
        axes.grid(False)
        axes.legend(loc="lower right")

    figure(path, draw, height=5.2)


def learning(workplace: Workplace, path: Path) -> None:
    """Tracks of a batch of vessels to their goals, in current, waves and gusts."""
    boats, seconds = 48, 40

    def goals(rng: np.random.Generator, count: int) -> Any:
        bearing_rad = np.arange(count) * (2.0 * np.pi / count)
        return 20.0 * np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=1)

    def still_away(before: xitl.Vessels, action: Any, after: xitl.Vessels) -> Any:
        return -np.hypot(*(after.goal - after.position_ned_m[:, :2]).T)

    env = xitl.make_vec_env(
        "sitl",
        boats,
        reward=still_away,
        goal=goals,
        start=lambda rng, count: (np.zeros((count, 2)), rng.uniform(-np.pi, np.pi, count)),
        observe=["to_goal", "rates"],
    )
    observed, _ = env.reset(seed=1)
    tracks, gone = [env.vessels.position_ned_m[:, :2]], np.zeros(boats, dtype=bool)
    for _ in range(50 * seconds):
        ahead_m, right_m, turn_rate = observed[:, 0], observed[:, 1], observed[:, 4]
        error_rad = np.arctan2(right_m, ahead_m)
        turn = np.clip(0.8 * error_rad - 0.6 * turn_rate, -0.4, 0.4)
        thrust = 0.6 * np.maximum(np.cos(error_rad), 0.0)
        observed, rewards, *_ = env.step(np.clip(np.stack([thrust + turn, thrust - turn], axis=1), -1.0, 1.0))
        gone |= rewards > -1.5
        tracks.append(np.where(gone[:, None], tracks[-1], env.vessels.position_ned_m[:, :2]))
    north_m, east_m = np.moveaxis(np.array(tracks), -1, 0)
    ends = env.vessels.goal
    env.close()

    def draw(axes: Any) -> None:
        axes.plot(east_m, north_m, color=BLUE, linewidth=1.0, alpha=0.8)
        axes.plot(ends[:, 1], ends[:, 0], "o", color=AMBER, markersize=5)
        axes.plot(0.0, 0.0, "o", color=INK, markersize=6)
        axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")

    figure(path, draw, width=6.2, height=5.8)


def identification(workplace: Workplace, path: Path) -> None:
    """A boat over 30 s that the fit did not use: measured, and predicted by two vehicles."""
    from xitl_cli.plugins.identify.free_keys import free_keys, with_values
    from xitl_cli.plugins.identify.identification import Settings, identify
    from xitl_cli.plugins.identify.log_recording import read_log
    from xitl_cli.profile.schema.agents import ReplaySpec

    vehicle = xitl.load_profile("vehicles/asv-third").vehicle
    workplace.typed(EXCITATION)
    log = workplace.folder / "runs/excitation/autopilot.bin"
    keys = free_keys(vehicle, (), ())
    start = with_values(vehicle, keys, np.random.default_rng(2).uniform(-0.5, 0.5, len(keys)))
    found = identify([read_log(log, vehicle, ReplaySpec(), "estimate")], start, Water(), Settings())
    shown = found.predictions[-1]
    time_s = shown.time_s - shown.time_s[0]

    def draw(axes: Any) -> None:
        for own, axis, label, scale in ((axes[0], 0, "surge (m/s)", 1.0), (axes[1], 2, "yaw rate (deg/s)", 57.2958)):
            own.plot(
                time_s, scale * shown.before[:, axis], color=AMBER, linewidth=1.4, label="predicted, first vehicle"
            )
            own.plot(time_s, scale * shown.measured[:, axis], color=INK, linewidth=2.2, label="measured")
            own.plot(
                time_s, scale * shown.predicted[:, axis], "--", color=BLUE, linewidth=1.6, label="predicted, identified"
            )
            own.set(xlabel="time (s)", ylabel=label)
        axes[0].legend(frameon=False, fontsize=9)

    figure(path, draw, panels=2)


_MODELS = {"identified": BLUE, "shipped": GREEN, "first": GREEN, "authors": RED, "linear": AMBER, "persistence": GREY}


def real_boat(workplace: Workplace, path: Path, section: str = "BlueBoat") -> None:
    """Errors of predictions of a real boat over the length of a window, from a table of docs/sim-to-real.md."""
    page = (Path(__file__).parents[2] / "docs/sim-to-real.md").read_text(encoding="utf-8")
    own_section = page.split(f"\n## {section}\n")[1].split("\n## ")[0]
    errors: dict[str, list[tuple[float, ...]]] = {}
    window_s = 0.0
    for row in re.findall(r"^\|((?:[^|\n]*\|){7})$", own_section, re.MULTILINE):
        window, model, *cells = [cell.strip() for cell in row.split("|")[:7]]
        if model in _MODELS:
            window_s = float(window.removesuffix(" s")) if window else window_s
            errors.setdefault(model, []).append((window_s, *map(float, cells)))

    def draw(axes: Any) -> None:
        for own, column, label in ((axes[0], 1, "error of surge (m/s)"), (axes[1], 3, "error of yaw rate (rad/s)")):
            for model, rows in errors.items():
                points = np.array(rows)
                own.plot(points[:, 0], points[:, column], "o-", color=_MODELS[model], label=model)
            lengths = [f"{length:g}" for length in points[:, 0]]
            own.set(xlabel="length of the prediction (s)", ylabel=label, xscale="log", ylim=(0.0, None))
            own.set_xticks(points[:, 0], lengths)
            own.minorticks_off()
        axes[0].legend(frameon=False, fontsize=9)

    figure(path, draw, panels=2)


def twin(workplace: Workplace, path: Path) -> None:
    """The evidence of a twin for each difference, from the log of a boat with a weak port propeller."""
    import lzma

    from xitl_cli.plugins.twin.boat import Outputs, open_boat
    from xitl_cli.plugins.twin.diagnosis import ALARM
    from xitl_cli.plugins.twin.session import Twin
    from xitl_cli.record.recorder import Recorder

    packed = Path(__file__).parents[2] / "tests" / "data" / "captures" / "twin-port-thrust.tlog.xz"
    boat = workplace.folder / "boat.tlog"
    boat.write_bytes(lzma.decompress(packed.read_bytes()))
    vehicle = xitl.load_profile("vehicles/otter").vehicle
    recorder = Recorder(workplace.folder / "boat-twin.mcap", "lz4", links=("boat",))
    rows: list[tuple[int, Any]] = []
    session = Twin(open_boat(str(boat)), vehicle, Water(density_kgpm3=1025), Outputs(), recorder)
    recorder.watch("/twin/evidence", lambda stamp_ns, names, evidence, threshold: rows.append((stamp_ns, evidence)))
    alarm = session.run(None, lambda text: None, lambda: False).alarms[0]
    recorder.close()
    time_s, evidence = np.array([stamp_ns * 1e-9 for stamp_ns, _ in rows]), np.array([row for _, row in rows])
    shown = (time_s > 50.0) & (time_s < alarm.at_ns * 1e-9)

    def draw(axes: Any) -> None:
        names = ("thrust port", "thrust starboard", "drag", "current", "compass", "GNSS")
        for number, (name, colour) in enumerate(zip(names, (RED, BLUE, AMBER, GREEN, GREY, INK), strict=True)):
            axes.plot(time_s[shown], np.maximum(evidence[shown, number], -10.0), color=colour, label=name)
        axes.axhline(ALARM, color=INK, linewidth=1.0, linestyle="--")
        axes.axvline(60.0, color=INK, linewidth=1.0, linestyle=":")
        axes.annotate("alarm threshold", (50.5, ALARM + 0.6))
        axes.annotate("port propeller at 70 % from here", (60.2, 46.0))
        axes.set(xlabel="time (s)", ylabel="evidence (log likelihood ratio)")
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.9), frameon=False)

    figure(path, draw)
