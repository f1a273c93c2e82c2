"""Settings of a companion: its parameters, which users set, and the tuned numbers of its algorithms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Callable

from agent.mavlink.exchange import Messages
from agent.mavlink.parameter_rows import Parameter, ParameterError, within
from agent.mavlink.parameters import ParameterServer

TABLE = (
    Parameter("AVD_ENABLE", 1, 0, 1, "", "1 steers around obstacles"),
    Parameter("AVD_HORIZON", 12.0, 2.0, 60.0, "s", "horizon of the collision check"),
    Parameter("AVD_MARGIN", 3.0, 0.5, 30.0, "m", "clearance between hull and obstacle"),
    Parameter("AVD_RANGE", 60.0, 5.0, 260.0, "m", "obstacles farther away are ignored"),
    Parameter("AVD_VESSELS", 0, 0, 1, "", "1 treats long moving objects as vessels, 0 as structure"),
    Parameter("HULL_LENGTH", 2.3, 0.2, 100.0, "m", "length of the vessel"),
    Parameter("HULL_WATER", 0.15, -5.0, 10.0, "m", "from the body's origin down to the water at rest"),
    Parameter("HULL_WIDTH", 1.6, 0.1, 50.0, "m", "width of the vessel"),
    Parameter("LIDAR_YAW", 0.0, -180.0, 180.0, "deg", "direction of the lidar, clockwise from the bow"),
    Parameter("MAP_CELL", 0.1, 0.02, 5.0, "m", "size of the map's cells, one point each"),
    Parameter("MAP_ENABLE", 1, 0, 1, "", "1 makes a map"),
    Parameter("MAP_RANGE", 60.0, 1.0, 260.0, "m", "farther points are not mapped"),
    Parameter("ODO_AIDED", 1, 0, 1, "", "1 lets the autopilot's attitude and velocity aid the odometry"),
    Parameter("ODO_ENABLE", 1, 0, 1, "", "1 runs the odometry"),
    Parameter("ODO_RANGE", 150.0, 5.0, 260.0, "m", "the odometry ignores farther points"),
    Parameter("ODO_VOXEL", 1.0, 0.05, 10.0, "m", "size of the cells of the odometry's local map"),
    Parameter("WP_SPEED", 3.0, 0.1, 30.0, "m/s", "speed of a mission that sets none"),
)
_ROWS = {row.name: row for row in TABLE}


def checked_parameter(name: str, value: float) -> float:
    """Return the value as it is stored. Raises ParameterError for an unknown name, NaN or a value out of range."""
    row = _ROWS.get(name)
    if row is None:
        raise ParameterError(f"{name} is not a setting of a companion; use one of {', '.join(_ROWS)}")
    return within(row, value)


class CompanionParameters:
    """Values by name, served by the parameter protocol. A new value applies from the first cloud of the next run.

    on_refused: called with the reason when a value is refused.
    """

    def __init__(self, on_refused: Callable[[str], object] = lambda problem: None) -> None:
        self._values = {row.name: float(row.default) for row in TABLE}
        self._on_refused = on_refused
        types = {row.name: row.type for row in TABLE}
        self._server = ParameterServer(types, self.__getitem__, self._set, self._refuse, per_poll=len(TABLE))

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def handle(self, message: Any) -> Messages:
        """Answer PARAM_SET, PARAM_REQUEST_READ and PARAM_REQUEST_LIST. Return nothing for other messages."""
        handler = self._server.handlers.get(message.get_msgId())
        return [] if handler is None else [*handler(message, 0), *self._server.poll()]

    def _set(self, name: str, value: float) -> None:
        self._values[name] = checked_parameter(name, value)

    def _refuse(self, problem: str) -> Messages:
        self._on_refused(problem)
        return []


@dataclass(frozen=True)
class PerceptionTuning:
    """Tuned numbers of odometry, obstacle detection, tracking and avoidance. All use the one instance `TUNED`.

    If a comment gives no other source, the value was tuned on the shipped river (profiles/sites, `sitl-perception`). It
    has a Mid-70 at 10 clouds a second, waves of 0.2 m, and debris that drifts with the current. The values were then
    checked on seeds that were not used for tuning, see docs/perception.md.

    Suffixes are units. `share` and `gain` are dimensionless. `hits`, `clouds`, `points` and `plans` are counts.
    """

    # Water plane: a plane through the low points at short range, by trimmed least squares.
    water_near_m: float = 12.0  # beyond it, level water returns no light, because the angle is too flat
    water_far_m: float = 20.0  # wave crests return light up to this range
    water_far_crest_m: float = 0.3  # above the water at the body: lower returns beyond `near` are crests
    water_crest_m: float = 0.25  # above the plane: lower returns within `near` are waves
    water_height_share: float = 0.1  # weight of one cloud in the filtered height of the body, which waves change
    water_points: int = 50  # fewer points do not define a plane
    water_fit_range_m: float = 9.0  # range of the points to fit
    water_fit_height_m: float = 1.5  # height of these points from the body's origin; most of them are water
    water_trims_m: tuple[float, ...] = (0.5, 0.25, 0.15)  # residuals kept from one fit to the next
    water_slope: float = 0.4  # a steeper plane is not water

    # Odometry.
    odometry_points: int = 30  # fewer points above the water do not determine the pose
    odometry_clouds_lost: int = 10  # refused in a row: the local map restarts
    icp_threshold_m: float = 0.5  # scale of the robust kernel; pairs are at most 3 times as far apart. Fixed:
    # KISS-ICP's adaptive scale stays at its start, 2 m, while a vessel moves evenly, and then forms wrong pairs
    icp_iterations: int = 20  # further iterations change less than the noise of a pose
    icp_voxel_share: float = 0.15  # of ODO_VOXEL: cells that thin a cloud for registration
    icp_water_voxel_share: float = 1.5  # the same for its water, which then carries height and attitude only
    map_voxel_share: float = 0.1  # of ODO_VOXEL: cells that thin the points of the local map
    map_water_voxel_share: float = 0.75  # the same for its water

    # Aided odometry filter: noises were tuned on six runs with three to four detours each.
    aided_initial_place_m2: float = 1e-6  # initial variance of position
    aided_initial_turn_rad2: float = 1e-6  # initial variance of attitude
    aided_initial_vel_m2ps2: float = 0.04  # initial variance of velocity
    aided_resumed_place_m2: float = 0.09  # variance of position after clouds without the autopilot
    aided_resumed_turn_deg: float = 2.0  # standard deviation of attitude after clouds without the autopilot
    aided_process_place_m: float = 0.02  # standard deviations added per second: error of the
    aided_process_turn_deg: float = 0.15  # autopilot's estimate from second to second
    aided_process_vel_mps: float = 0.05
    aided_point_m: float = 0.5  # of a point to its pair: the local map has a point every few decimetres
    aided_registration_m: float = 0.02  # of a registered pose, for any number of points: position
    aided_registration_tilt_rad: float = 0.05  # roll and pitch, which gravity determines better
    aided_registration_yaw_rad: float = 0.001  # yaw
    aided_down_rad: float = 0.01  # of the autopilot's down direction
    aided_height_m: float = 0.25  # of the water in one cloud: waves last longer than a cloud
    aided_gate_m: float = 1.0  # a registration farther from the prediction is refused
    aided_gate_rad: float = 0.1  # a registration rotated by more is refused; added to each of these limits:
    aided_gate_deviations: float = 3.0  # number of standard deviations of the prediction
    aided_most_gain_mps2: float = 10.0  # a velocity that changes faster was wrong before
    aided_doubted_mps: float = 1.0  # uncertainty of the velocity after such a change
    aided_reference_clouds: int = 50  # their means define down and the height of the water

    # Lidar-only odometry filter.
    lidar_only_surprise_mps: float = 8.0  # prediction to pose, per second; vessels accelerate by some m/s per second
    lidar_only_gains: tuple[float, ...] = (0.8, 0.8, 0.3, 0.9, 0.9, 0.9)  # alphas of the alpha-beta filter for a twist
    lidar_only_rocking_gain: float = 0.65  # of the rotation rate against the water in a cloud: waves tilt the water too
    lidar_only_reference_clouds: int = 30  # their mean is the plane of the water: some periods of the waves
    lidar_only_level_gain: float = 0.2  # of the tilt off the water, removed with every cloud; averages waves
    lidar_only_height_gain: float = 0.4  # the same for the height

    # Obstacle detection: cells above the water.
    cell_m: float = 0.5
    detect_nearest_m: float = 2.5  # closer points are the vessel itself, and spray
    detect_lowest_m: float = -1.2  # of obstacles beyond the water's returns: a degree of pitch is 0.5 m at 30 m
    detect_highest_m: float = 2.5
    detect_knots: int = 5  # poses per cloud, between which points are interpolated
    reach_rings: int = 24  # of 1 m each, in which returns of water are counted
    reach_sectors: int = 14  # over 70 degrees, the lidar's view
    reach_sector_deg: float = 5.0
    reach_low_m: float = 0.35  # from the mean water: such points may be water
    reach_forget_gain: float = 0.9  # of the counts, from cloud to cloud
    reach_count: float = 0.8  # a sector with more is wet
    reach_wet_share: float = 0.45  # of the sectors: then the ring is water
    reach_initial_m: float = 20.0  # before enough clouds were seen
    reach_learnt_clouds: int = 20  # number of these clouds
    reach_beyond_m: float = 2.0  # beyond the last ring of water
    reach_shrink_m: float = 0.03  # per cloud at most: visible waves far off vary
    reach_grow_m: float = 0.05  # per cloud at most: a boom across the view first looks like water
    stands_out_m: float = 0.2  # above the spread of the waves: then it is not water
    bright_points: int = 30  # low points needed to estimate the brightness of water
    bright_step: float = 3.0  # of 150 for all light, above the median of water: wood and hide reflect more
    bright_nearest_m: float = 8.0  # closer water glints
    float_level_s: float = 15.0  # time constant of the floating height: heave takes seconds
    float_level_off_m: float = 0.4  # limit of that height from the present one

    # Segmentation of cells into clusters.
    cluster_join_m: float = 1.0  # adjacent cells of this size form a cluster
    cluster_frames: int = 2  # a cell seen in only one frame is spray or a glint
    cluster_points: int = 3
    cluster_points_per_m: float = 5.0  # in doubtful water, where crests glint

    # Structure: too long to drift (boom, banks, dam).
    structure_kept_ns: int = 600_000_000_000
    structure_unseen_ns: int = 2_500_000_000  # a cell in view without a hit for this time does not exist
    structure_settled_ns: int = 1_500_000_000  # a cell counts when its hits span this time
    structure_settled_hits: int = 6  # least number of these hits
    structure_wet_ns: int = 8_000_000_000  # the same in water that returns light
    structure_wet_hits: int = 40
    structure_wet_kept_ns: int = 20_000_000_000
    wet_hit_ns: int = 280_000_000  # largest mean interval of hits there: crests vary, every look hits structure
    strewn_share: float = 1.4  # of the water's range: single crests return light up to there
    structure_view_deg: float = 28.0  # to either side
    structure_far_m: float = 100.0

    # Tracking of drifting objects.
    track_longest_m: float = 9.0  # a longer cluster is structure: a trunk is at most 8 m
    track_beside_m: float = 2.0  # from structure: a closer cluster belongs to it
    track_gate_m: float = 2.5
    track_hits: int = 4  # to confirm a track
    track_confirmed_ns: int = 700_000_000  # time that these hits must span
    track_wet_hits: int = 20  # the same for objects first seen in water that returns light, or a little beyond
    track_bright_points: int = 4  # brighter than water: then it is not water
    track_bright_hits: int = 6  # and these hits confirm it
    track_odd_mps: float = 1.0  # difference from the water's drift that requires
    track_odd_hits: int = 12  # more hits
    track_odd_wet_mps: float = 0.6
    track_lost_ns: int = 2_500_000_000  # in view without a hit
    track_looked_for_ns: int = 100_000_000  # added for every hit
    track_looked_for_most_ns: int = 6_000_000_000  # limit of this sum: waves hide low objects
    track_doubtful_ns: int = 1_200_000_000  # the same for an unconfirmed track, in water
    track_doubtful_far_ns: int = 1_500_000_000  # the same beyond water
    track_coasted_ns: int = 12_000_000_000  # out of view, at most
    track_coasts_ns: int = 700_000_000  # added for every hit
    track_born_m: float = 8.0  # no track starts closer: bow wave, and crests under the bow
    track_view_deg: float = 29.0  # to either side
    track_view_m: float = 45.0
    track_start_mps: float = 0.4  # standard deviation of a new track's velocity
    track_drive_m2ps3: float = 0.01  # drive of the velocities' random walk
    track_crest_gain: float = 9.0  # of the variance, among returns of water
    track_shrink_gain: float = 0.99  # of the stored size, per look
    track_fastest_mps: float = 2.5
    track_grows_m: float = 3.0  # between two looks, if the cluster turns into structure or back

    # Other vessels: objects that move as a whole. Tuned on vessels of 2 to 40 m at 0.8 to 2.5 m/s in open water.
    outline_view_m: float = 55.0  # ends farther off may be at the limit of the lidar's range
    outline_shortest_ns: int = 2_000_000_000  # between two looks to compare
    outline_longest_ns: int = 4_000_000_000
    outline_least_m: float = 1.5  # three cells: least distance of its middle
    outline_least_mps: float = 0.5  # least speed of its middle
    outline_share: float = 0.6  # least part of that distance for both ends
    outline_nearer: float = 0.5  # one end only: least approach as a part of its distance
    outline_looks: int = 3  # consecutive looks
    outline_off_mps: float = 0.4  # a velocity farther off is replaced by that of the outline
    outline_rest_mps: float = 0.2  # a slower object has stopped
    vessel_m: float = 7.0  # longer than drifting objects, except trunks
    vessel_grows_m: float = 6.0  # a longer cluster is not part of the vessel
    vessel_place_m: float = 0.6  # standard deviation of its edge: a cell, and the motion during a cluster
    vessel_shrink_gain: float = 0.998  # of the stored size, per look: often only a part is visible
    vessel_slender: float = 4.0  # least ratio of length to beam, while only bow or stern is visible
    vessel_fastest_mps: float = 15.0
    vessel_coasted_ns: int = 25_000_000_000  # out of view; a vessel keeps its course better than drifting objects

    # Obstacle avoidance: when detection and tracking run, and when a path counts as blocked.
    look_ns: int = 180_000_000  # between two clusterings
    look_waiting_clouds: int = 4  # held until their pose is known
    look_structure_m: float = 50.0
    look_stale_ns: int = 2_000_000_000  # without clouds for this time, no path is known to be free
    begin_share: float = 0.6  # of AVD_MARGIN: a path with less clearance is blocked
    doubtful_share: float = 1.6  # of the water's reach

    # Vessel model of the simulated courses.
    course_lookahead_m: float = 6.0
    course_turn_gain_per_s: float = 1.2  # turn rate per remaining change of course
    course_turn_degps: float = 22.0
    course_acceleration_mps2: float = 0.6
    course_reached_m: float = 3.0
    course_current_mps: float = 0.3  # a current with full weight
    course_slowest_turn: float = 0.25  # of the requested speed, with the bow far off

    # Avoidance course: candidates and costs.
    plan_courses_deg: float = 120.0  # to either side of the leg
    plan_courses_step_deg: float = 10.0  # between candidates
    plan_holds_s: tuple[float, ...] = (1.6, 3.2, 6.0, 10.0)
    plan_speeds: tuple[float, ...] = (1.0, 0.45)  # of the mission's speed
    plan_far_m: float = 60.0
    plan_farther: float = 1.5  # times the horizon: range of the comparison of courses
    plan_worth: float = 0.3  # of the mission's progress in that time: leave the mission only for more
    plan_leaving_worth: float = 0.45  # the same for leaving a stop
    plan_gain_share: float = 0.5  # of the remaining path, if it is short
    plan_leaving_cost: float = 1.0  # of any course except the legs: equal courses are no reason to leave them
    plan_lee_cost: float = 6.0  # per metre of mean distance down the current
    plan_lee_margins: float = 2.0  # clearance to structure in the lee, in margins
    plan_lee_short_cost: float = 2.0
    plan_retreats_m: tuple[float, ...] = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0)
    plan_retreat_mps: float = 1.2
    plan_touch_m: float = 0.8  # a smaller clearance counts as a collision
    plan_spread_mps: float = 0.06  # uncertainty of a track's drift
    plan_stray_mps: float = 0.15  # the same of a track out of view
    plan_stray_most_m: float = 1.5
    plan_structure_points: int = 400

    # Command output.
    blocked_plans: int = 2  # in a row, before taking control
    blocked_far_plans: int = 8  # the same if the collision is later than
    blocked_soon_s: float = 8.0  # this time
    free_plans: int = 4  # in a row, before the mission gets control back
    freer_m: float = 0.5  # more clearance than a detour begins at
    back_m: float = 1.2  # off the leg: the vessel is back on it
    back_deg: float = 20.0
    end_m: float = 6.0  # before the leg's end, returning to the leg is pointless
    moved_m: float = 3.0  # a better waiting position is used when it is this far off


TUNED = PerceptionTuning()
