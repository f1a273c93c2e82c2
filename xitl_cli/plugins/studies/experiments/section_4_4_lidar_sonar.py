"""Section 4.4: fused lidar and sonar in front of a half-submerged branch and a trunk under water.

The vessel is at rest in turbid water with ripples. The points of each sensor on each body can therefore be counted
against the true positions of the bodies. The lidar's cloud shows water plane and branch, the sonar's echoes branch and
sunken trunk. The companion sends its detections to the autopilot as proximity messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import quat_to_matrix
from sim_core.world.debris import BodyKind, make_body
from sim_core.world.geometry import WOOD, cylinder
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup, write_file
from xitl_cli.experiment.time_series import Floats
from xitl_cli.extras import PERCEPTION
from xitl_cli.logs import open_log
from xitl_cli.logs.model.log import Log
from xitl_cli.plugins.studies.experiments.figures import OTHER, OURS, PAPER, THIRD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DURATION_S = 30.0
BRANCH_NE_M, BRANCH_LENGTH_M, BRANCH_HEADING_DEG = (9.0, 2.5), 3.0, 70.0
TRUNK_NE_M, TRUNK_LENGTH_M, TRUNK_RADIUS_M, TRUNK_DOWN_M, TRUNK_HEADING_DEG = (10.0, -4.0), 4.0, 0.35, 1.3, 60.0
_MESH = "sunken-trunk.obj"
_AROUND_M = 0.6  # margin about a body for an echo's beam width and a body's slow rotation
_ABOVE_M = 0.1  # margin above the water surface
_BELOW_M = 0.15  # under the water: beyond the lidar's noise
_NEAREST_M = 1.5  # excludes the vessel itself
_EVERY = 5  # use every fifth cloud
_DRAWN = 12_000  # points of a panel
_SECTOR_DEG = 5.0
_SENT = "/link/agent/tx:"
_PROXIMITY = ("OBSTACLE_DISTANCE", "DISTANCE_SENSOR")


@dataclass(frozen=True, slots=True)
class Footprint:
    """Area in plan: all points within `around_m` of a line of this length."""

    middle_ne_m: tuple[float, float]
    """North and east."""
    length_m: float
    heading_deg: float
    around_m: float

    def holds(self, points_ned_m: Floats) -> NDArray[np.bool_]:
        """Return (N,) True for points (N, 3) in the area."""
        along = np.array([np.cos(np.radians(self.heading_deg)), np.sin(np.radians(self.heading_deg))])
        apart = points_ned_m[:, :2] - np.array(self.middle_ne_m)
        on_line = np.clip(apart @ along, -0.5 * self.length_m, 0.5 * self.length_m)
        off: Floats = np.linalg.norm(apart - on_line[:, None] * along, axis=1)
        return np.asarray(off <= self.around_m)


BRANCH = Footprint(BRANCH_NE_M, BRANCH_LENGTH_M, BRANCH_HEADING_DEG, _AROUND_M)
TRUNK = Footprint(TRUNK_NE_M, TRUNK_LENGTH_M, TRUNK_HEADING_DEG, TRUNK_RADIUS_M + _AROUND_M)


@dataclass(frozen=True, slots=True)
class FusedCloud:
    """Points of both sensors, placed by the true poses, north, east, down from the start."""

    lidar_ned_m: Floats
    """Lidar points, (N, 3)."""
    sonar_ned_m: Floats
    """Sonar points, (M, 3)."""
    water_down_m: float
    """Down coordinate of the water surface."""
    ranges_m: Mapping[float, float] = field(default_factory=dict)
    """Ranges of the last OBSTACLE_DISTANCE by bearing (deg)."""
    proximity: Mapping[str, int] = field(default_factory=dict)
    """Number of proximity messages to the autopilot."""

    @property
    def height_m(self) -> Floats:
        """Heights of the lidar's points above the water, (N,)."""
        found: Floats = self.water_down_m - self.lidar_ned_m[:, 2]
        return found

    def lidar_in(self, footprint: Footprint) -> int:
        """Count the lidar's points above the water in an area."""
        return int((footprint.holds(self.lidar_ned_m) & (self.height_m > _ABOVE_M)).sum())

    def lidar_below(self) -> int:
        """Count the lidar's points under the surface."""
        return int((self.height_m < -_BELOW_M).sum())

    def water(self) -> NDArray[np.bool_]:
        """Return (N,) True for lidar points on the water."""
        return np.asarray(np.abs(self.height_m) <= _ABOVE_M) & ~BRANCH.holds(self.lidar_ned_m)

    def told_toward(self, place_ne_m: tuple[float, float]) -> float | None:
        """Return the range (m) of the sector toward this place, None for an empty sector."""
        bearing_deg = float(np.degrees(np.arctan2(place_ne_m[1], place_ne_m[0])))
        nearest = min(self.ranges_m, key=lambda each: abs(each - bearing_deg), default=None)
        if nearest is None or abs(nearest - bearing_deg) > _SECTOR_DEG:
            return None
        return round(self.ranges_m[nearest], 2)

    def sonar_in(self, footprint: Footprint) -> int:
        """Count the echoes in an area."""
        return int(footprint.holds(self.sonar_ned_m).sum())


def lidar_sonar_report(setup: ExperimentSetup) -> ExperimentReport:
    """Carry out one run. Raises UserError if perception is not installed, and InterruptedRunError."""
    PERCEPTION.require("lidar and sonar need")
    duration_s = setup.duration_s or DURATION_S
    write_file(setup.out / _MESH, trunk_mesh())
    result = setup.run_profile("scene", scene_profile(setup.seed, duration_s), timed=True)
    setup.tell(f"lidar and sonar over {duration_s:g} s: {result.directory}")
    with open_log(result.recording) as log:
        cloud = fused_cloud(log)
    rows = tuple(_rows(cloud))
    return ExperimentReport(
        section="4.4",
        title="Lidar and sonar before a half-submerged branch and a sunken trunk",
        notes=(
            "Turbid water with ripples; points by the true pose, counted against where the bodies are. The paper shows "
            "the clouds and counts nothing; a sonar does not tell the depth of an echo, drawn at that of its axis.",
        ),
        rows=rows,
        figures=(
            PaperFigure(
                "4.4-cloud",
                "The fused cloud from above and from the side: lidar on the water and above it, sonar below (the "
                "paper's figures 25a and 25b).",
                lambda figure: _draw_cloud(figure, cloud),
                (7.0, 7.4),
            ),
            PaperFigure(
                "4.4-proximity",
                "What the autopilot is told: ranges of OBSTACLE_DISTANCE by bearing, and where branch and trunk are.",
                lambda figure: _draw_proximity(figure, cloud),
                (4.6, 3.4),
            ),
        ),
        runs=(str(result.directory),),
        completed=result.exit_code == 0 and seen_as_in_the_paper(cloud),
        details={"proximity": dict(cloud.proximity)},
    )


def seen_as_in_the_paper(cloud: FusedCloud) -> bool:
    """Return True if each sensor shows the same as in the paper, and the autopilot received it."""
    seen = (cloud.water().sum(), cloud.lidar_in(BRANCH), cloud.sonar_in(TRUNK), sum(cloud.proximity.values()))
    return all(seen) and not cloud.lidar_in(TRUNK) and not cloud.lidar_below()


def scene_profile(seed: int, duration_s: float) -> str:
    """Return the profile: the vessel at rest, bow to the north, branch and trunk in front of it."""
    return (
        "# Section 4.4 of the paper: lidar and sonar before a floating branch and a trunk under water.\n"
        "extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full, sensors/perception, environments/calm]\n"
        "description: Lidar and sonar before a half-submerged branch and a sunken trunk\n\n"
        "technique: sitl\n"
        "driver: {kind: none}\n"
        "mission: {start: {north_m: 0.0, east_m: 0.0, heading_deg: 0.0}, waypoints_ned_m: []}\n"
        "environment: {waves: {spectrum: jonswap, significant_height_m: 0.06, peak_period_s: 1.5, spreading: 10.0}}\n"
        "companion: {runs: process, link: 'tcp://127.0.0.1:0'}\n"
        "sensors:\n"
        "  lidar: {yaw_deg: 0.0}\n"
        "  sonar: {sector_deg: [-45.0, 45.0], step_grad: 1, range_m: 15.0}\n"
        "world:\n"
        "  log_boom: null\n"
        "  dam: null\n"
        "  debris:\n"
        f"    launches: [{{kind: branch, pos_ned_m: {list(BRANCH_NE_M)}, heading_deg: {BRANCH_HEADING_DEG}, "
        f"length_m: {BRANCH_LENGTH_M}}}]\n"
        f"  meshes: [{{file: {_MESH}, material: wood, position_ned_m: [{TRUNK_NE_M[0]}, {TRUNK_NE_M[1]}, "
        f"{TRUNK_DOWN_M}], heading_deg: {TRUNK_HEADING_DEG}}}]\n"
        f"clock: {{seed: {seed}, duration_s: {duration_s:g}}}\n"
    )


def trunk_mesh() -> str:
    """Return a trunk along north as an OBJ file: x east, y north, z up."""
    mesh = cylinder(TRUNK_RADIUS_M, TRUNK_LENGTH_M, WOOD)
    corners = (f"v {east:.4f} {north:.4f} {-down:.4f}\n" for north, east, down in mesh.vertices_m.tolist())
    faces = (f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in mesh.faces.tolist())
    return "".join(("# sunken trunk, metres\n", *corners, *faces))


def fused_cloud(log: Log) -> FusedCloud:
    """Place both sensors' points of a recording by its true poses. Raises UserError without clouds."""
    from agent.companion.sonar import echo_points
    from xitl_cli.mapping.clouds import at, clouds, pings, truth

    poses = truth(log)
    if poses is None:
        raise UserError(f"{log.path}: holds no true motion; record a run with its truth")

    def placed(stamps: NDArray[np.int64], points_frd_m: NDArray[np.float32]) -> Floats:
        stamps = np.clip(stamps, poses.stamp_ns[0], poses.stamp_ns[-1])
        pose = at(poses, stamps)
        ned = np.einsum("nij,nj->ni", quat_to_matrix(pose.quat_wxyz), points_frd_m) + pose.pos_m
        far: Floats = ned[np.linalg.norm(points_frd_m[:, :2], axis=1) > _NEAREST_M]
        return far

    lidar = [
        placed(cloud.stamp_ns + (cloud.offset_s * 1e9).astype(np.int64), cloud.points_m)
        for number, cloud in enumerate(clouds(log))
        if not number % _EVERY
    ]
    sonar = []
    for ping in pings(log):
        points_frd_m, _ = echo_points(ping)
        sonar.append(placed(np.full(len(points_frd_m), ping.stamp_ns), points_frd_m))
    cloud_ned_m = np.concatenate([np.empty((0, 3)), *lidar])
    level = cloud_ned_m[np.abs(cloud_ned_m[:, 2]) < 1.0, 2]
    return FusedCloud(
        cloud_ned_m,
        np.concatenate([np.empty((0, 3)), *sonar]),
        float(np.median(level)) if len(level) else 0.0,
        _ranges_m(log),
        {name: len(log.tables[_SENT + name]) for name in _PROXIMITY if _SENT + name in log.tables},
    )


def _ranges_m(log: Log) -> dict[float, float]:
    """Return the ranges of the last OBSTACLE_DISTANCE with values: bearing to starboard (deg) and range."""
    table = log.tables.get(_SENT + "OBSTACLE_DISTANCE")
    if table is None or not len(table):
        return {}
    every, most = table.values("distances", raw=True), table.values("max_distance", raw=True)
    step, offset = table.values("increment_f", raw=True), table.values("angle_offset", raw=True)
    for row in range(len(table) - 1, -1, -1):
        known = np.flatnonzero(np.asarray(every[row]) <= int(most[row]))
        if len(known):
            bearings = (float(offset[row]) + known * float(step[row]) + 180.0) % 360.0 - 180.0
            return dict(zip(bearings.tolist(), (0.01 * np.asarray(every[row])[known]).tolist(), strict=True))
    return {}


def _rows(cloud: FusedCloud) -> Iterator[PaperRow]:
    branch = make_body(BodyKind.BRANCH, BRANCH_LENGTH_M)
    water = cloud.water()
    rough_mm = 1e3 * float(np.std(cloud.height_m[water])) if water.any() else 0.0
    yield PaperRow(
        "water plane in the lidar",
        "seen",
        int(water.sum()),
        "returns",
        f"A plane within {rough_mm:.0f} mm RMS, in waves of 0.06 m: turbid water sends light back.",
    )
    below = cloud.lidar_below()
    yield PaperRow(
        "lidar under the water",
        "none",
        below,
        "returns",
        "As in the paper." if not below else "The paper's lidar sees nothing there.",
    )
    yield PaperRow(
        "branch in the lidar",
        "seen",
        cloud.lidar_in(BRANCH),
        "returns",
        f"{branch.height_m:.2f} m of it are above the water, {branch.draught_m:.2f} m below.",
    )
    yield PaperRow("branch in the sonar", "seen", cloud.sonar_in(BRANCH), "echoes", "Echoes from the part under water.")
    trunk_lidar = cloud.lidar_in(TRUNK)
    deep = f"Its top is {TRUNK_DOWN_M - TRUNK_RADIUS_M:.2f} m under water."
    yield PaperRow(
        "sunken trunk in the lidar",
        "unseen",
        trunk_lidar,
        "returns",
        "The paper's lidar does not see it." if trunk_lidar else deep,
    )
    yield PaperRow("sunken trunk in the sonar", "seen", cloud.sonar_in(TRUNK), "echoes", "Only the sonar sees it.")
    sent = sum(cloud.proximity.values())
    kinds = ", ".join(f"{count} {name}" for name, count in cloud.proximity.items()) or "none"
    yield PaperRow("proximity messages", "sent", sent, "", f"To the autopilot: {kinds}.")
    told_m, true_m = cloud.told_toward(BRANCH_NE_M), float(np.hypot(*BRANCH_NE_M))
    yield PaperRow("reported range of the branch", None, told_m, "m", _reported_text(told_m, true_m))


def _reported_text(told_m: float | None, true_m: float) -> str:
    if told_m is None:
        return "No range was reported in its direction."
    if abs(told_m - true_m) <= BRANCH_LENGTH_M:
        return f"The branch, {true_m:.1f} m away."
    return f"Not the branch, {true_m:.1f} m away: another return that the companion classifies as an obstacle."


def _draw_cloud(figure: Figure, cloud: FusedCloud) -> None:
    """Draw the cloud from above, and below it from the side: forward against height."""
    above, side = figure.subplots(2, 1, height_ratios=(3, 1.5))
    _scatter(above, cloud, across=1)
    for footprint, words in ((BRANCH, "branch"), (TRUNK, "sunken trunk")):
        along = np.radians(footprint.heading_deg)
        half = 0.5 * footprint.length_m * np.array([np.cos(along), np.sin(along)])
        ends = np.array([footprint.middle_ne_m - half, footprint.middle_ne_m + half])
        above.plot(ends[:, 1], ends[:, 0], color="black", linewidth=1.0)
        above.annotate(words, ends[0, ::-1], textcoords="offset points", xytext=(6, -12), fontsize=8)
    above.plot([0.0], [0.0], "^", color="black", markersize=7, label="vessel")
    above.set_xlim(-10.0, 10.0)
    above.set_ylim(-1.0, 16.0)
    above.set_aspect("equal")
    above.set_xlabel("to starboard, east (m)")
    above.set_ylabel("ahead, north (m)")
    for each in above.legend(loc="upper right").legend_handles:
        if hasattr(each, "set_sizes"):
            each.set_sizes([20.0])
    _scatter(side, cloud, across=2)
    side.axhline(0.0, color="#555555", linewidth=0.8)
    from matplotlib.patches import Rectangle

    half_m = 0.5 * TRUNK_LENGTH_M * np.cos(np.radians(TRUNK_HEADING_DEG))
    corner = (TRUNK_NE_M[0] - half_m, -TRUNK_DOWN_M - TRUNK_RADIUS_M)
    side.add_patch(Rectangle(corner, 2.0 * half_m, 2.0 * TRUNK_RADIUS_M, fill=False, edgecolor="black", linewidth=1.0))
    side.annotate("sunken trunk", (TRUNK_NE_M[0] + 1.2, -TRUNK_DOWN_M), fontsize=8, va="center")
    side.set_xlim(-1.0, 16.0)
    side.set_ylim(-2.2, 1.4)
    side.set_xlabel("ahead, north (m)")
    side.set_ylabel("height above the water (m)")


def _scatter(axes: Axes, cloud: FusedCloud, across: int) -> None:
    """Draw lidar on the water, lidar above it, sonar. across: 1 for the view from above, 2 for the side view."""
    above = cloud.height_m > _ABOVE_M
    lifted = cloud.lidar_ned_m - np.array([0.0, 0.0, cloud.water_down_m])
    echoes = cloud.sonar_ned_m - np.array([0.0, 0.0, cloud.water_down_m])
    for points, colour, words, size in (
        (lifted[~above], "#b8d4e8", "lidar, water plane", 0.3),
        (lifted[above], OURS, "lidar, above it", 1.2),
        (echoes, OTHER, "sonar", 1.2),
    ):
        inside = points[(np.abs(points[:, 1]) < 10.0) & (points[:, 0] > -1.0) & (points[:, 0] < 16.0)]
        shown = inside[:: max(1, len(inside) // _DRAWN)]
        x, y = (shown[:, 1], shown[:, 0]) if across == 1 else (shown[:, 0], -shown[:, 2])
        axes.scatter(x, y, s=size, c=colour, label=words, linewidths=0, rasterized=True)


def _draw_proximity(figure: Figure, cloud: FusedCloud) -> None:
    axes = figure.add_subplot()
    if cloud.ranges_m:
        axes.plot(list(cloud.ranges_m), list(cloud.ranges_m.values()), "o", color=OURS, label="OBSTACLE_DISTANCE")
    for place, words, colour in ((BRANCH_NE_M, "branch, its middle", THIRD), (TRUNK_NE_M, "sunken trunk", PAPER)):
        axes.plot([np.degrees(np.arctan2(place[1], place[0]))], [np.hypot(*place)], "x", color=colour, label=words)
    axes.set_xlim(-45.0, 45.0)
    axes.set_ylim(0.0, 16.0)
    axes.set_xlabel("bearing to starboard (°)")
    axes.set_ylabel("range (m)")
    axes.legend(loc="lower right")
