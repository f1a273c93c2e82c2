"""Settings of a companion: its parameters, which users set, and the tuned numbers of its algorithms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Callable

from agent.fcu.parameters import Parameter, ParameterError, within
from agent.mavlink.exchange import Messages
from agent.mavlink.parameters import ParameterServer

TABLE = (
    Parameter("AVD_ENABLE", 1, 0, 1, "", "1 steers around obstacles"),
    Parameter("AVD_HORIZON", 12.0, 2.0, 60.0, "s", "how far ahead collisions are looked for"),
    Parameter("AVD_MARGIN", 3.0, 0.5, 30.0, "m", "water kept between hull and obstacle"),
    Parameter("AVD_RANGE", 60.0, 5.0, 260.0, "m", "obstacles farther away are ignored"),
    Parameter("AVD_VESSELS", 0, 0, 1, "", "1 takes what is long and moves for another vessel, 0 for structure"),
    Parameter("HULL_LENGTH", 2.3, 0.2, 100.0, "m", "of the vessel"),
    Parameter("HULL_WATER", 0.15, -5.0, 10.0, "m", "from the body's origin down to the water at rest"),
    Parameter("HULL_WIDTH", 1.6, 0.1, 50.0, "m", "of the vessel"),
    Parameter("LIDAR_YAW", 0.0, -180.0, 180.0, "deg", "direction of the lidar, clockwise from the bow"),
    Parameter("MAP_CELL", 0.1, 0.02, 5.0, "m", "edge of the cells of the map, one point each"),
    Parameter("MAP_ENABLE", 1, 0, 1, "", "1 keeps a map"),
    Parameter("MAP_RANGE", 60.0, 1.0, 260.0, "m", "farther points are not mapped"),
    Parameter("ODO_AIDED", 1, 0, 1, "", "1 lets the autopilot's attitude and velocity aid the odometry"),
    Parameter("ODO_ENABLE", 1, 0, 1, "", "1 runs the odometry"),
    Parameter("ODO_RANGE", 150.0, 5.0, 260.0, "m", "farther points are not used for it"),
    Parameter("ODO_VOXEL", 1.0, 0.05, 10.0, "m", "edge of the cells of its local map"),
    Parameter("WP_SPEED", 3.0, 0.1, 30.0, "m/s", "of the mission, where it does not say"),
)
_ROWS = {row.name: row for row in TABLE}


def checked_parameter(name: str, value: float) -> float:
    """The value as it would be kept. Raises ParameterError for an unknown name, NaN or a value out of range."""
    row = _ROWS.get(name)
    if row is None:
        raise ParameterError(f"{name} is no setting of a companion; use one of {', '.join(_ROWS)}")
    return within(row, value)


class CompanionParameters:
    """Values by name, served by the parameter protocol; a new value holds from the first cloud of the next run.

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
        """Answers to PARAM_SET, PARAM_REQUEST_READ and PARAM_REQUEST_LIST; none to other messages."""
        handler = self._server.handlers.get(message.get_msgId())
        return [] if handler is None else [*handler(message, 0), *self._server.poll()]

    def _set(self, name: str, value: float) -> None:
        self._values[name] = checked_parameter(name, value)

    def _refuse(self, problem: str) -> Messages:
        self._on_refused(problem)
        return []


@dataclass(frozen=True)
class PerceptionTuning:
    """Tuned numbers of odometry, obstacle detection, tracking and avoidance. One instance, `TUNED`, is used by all.

    Where a comment gives no other source, the value was chosen on the shipped river (profiles/sites, `sitl-perception`:
    a Mid-70 at 10 clouds a second, waves of 0.2 m, debris that drifts with the current) and then checked on seeds that
    nothing was chosen on, see docs/perception.md. Suffixes are units; `share` and `gain` are without unit, `hits`,
    `clouds`, `points` and `plans` are counts.
    """

    # Water plane: a plane through the low points close by, by trimmed least squares.
    water_near_m: float = 12.0  # level water returns no light from farther away, at so flat an angle
    water_far_m: float = 20.0  # wave crests return light up to here
    water_far_crest_m: float = 0.3  # above the water at the body: returns so low, beyond near, are crests
    water_crest_m: float = 0.25  # above the plane: returns so low, nearer, are waves
    water_height_share: float = 0.1  # of one cloud in the filtered height of the body, which waves change
    water_points: int = 50  # fewer make no plane
    water_fit_range_m: float = 9.0  # points fitted: no farther away, and
    water_fit_height_m: float = 1.5  # no farther up or down from the body's origin; most of these are water
    water_trims_m: tuple[float, ...] = (0.5, 0.25, 0.15)  # residuals kept from one fit to the next
    water_slope: float = 0.4  # a steeper plane is not water

    # Odometry.
    odometry_points: int = 30  # fewer that are not water say nothing of the pose
    odometry_clouds_lost: int = 10  # refused in a row: the local map is begun anew
    icp_threshold_m: float = 0.5  # scale of the robust kernel; pairs are 3 times that apart at most. Fixed: KISS-ICP's
    # adaptive one stays at its start, 2 m, as long as a vessel moves evenly, and pairs what does not belong together
    icp_iterations: int = 20  # what more of them change is below the noise of a pose
    icp_voxel_share: float = 0.15  # of ODO_VOXEL: cells that thin a cloud for registration, and
    icp_water_voxel_share: float = 1.5  # those of its water, thinned until it carries height and attitude only
    map_voxel_share: float = 0.1  # the same for what goes into the local map, and
    map_water_voxel_share: float = 0.75  # for its water

    # Aided odometry filter: noises were set on six runs with three to four detours each.
    aided_initial_place_m2: float = 1e-6  # variances where the odometry begins: position,
    aided_initial_turn_rad2: float = 1e-6  # attitude
    aided_initial_vel_m2ps2: float = 0.04  # and velocity
    aided_resumed_place_m2: float = 0.09  # variances after clouds that were placed without the autopilot: position;
    aided_resumed_turn_deg: float = 2.0  # standard deviation of attitude
    aided_process_place_m: float = 0.02  # standard deviations that a second adds: what the autopilot's estimate is off
    aided_process_turn_deg: float = 0.15  # by from second to second
    aided_process_vel_mps: float = 0.05
    aided_point_m: float = 0.5  # of a point to its pair: the local map has a point every few decimetres
    aided_registration_m: float = 0.02  # of a registered pose, however many points: position,
    aided_registration_tilt_rad: float = 0.05  # roll and pitch, of which gravity knows more,
    aided_registration_yaw_rad: float = 0.001  # and yaw
    aided_down_rad: float = 0.01  # of the autopilot's down
    aided_height_m: float = 0.25  # of one cloud's water: waves, which last longer than a cloud
    aided_gate_m: float = 1.0  # a registration is refused that is farther than this from the prediction
    aided_gate_rad: float = 0.1  # or turned by more, each plus
    aided_gate_deviations: float = 3.0  # standard deviations of the prediction
    aided_most_gain_mps2: float = 10.0  # a velocity that changes faster was wrong before,
    aided_doubted_mps: float = 1.0  # and may be off by so much now
    aided_reference_clouds: int = 50  # whose mean is down, and whose mean height is that of the water

    # Lidar-only odometry filter.
    lidar_only_surprise_mps: float = 8.0  # from prediction to pose, per second passed; vessels gain some m/s in one
    lidar_only_gains: tuple[float, ...] = (0.8, 0.8, 0.3, 0.9, 0.9, 0.9)  # alpha of the alpha-beta filter, of a twist
    lidar_only_rocking_gain: float = 0.65  # of the turn rate against the water in a cloud: waves turn the water too
    lidar_only_reference_clouds: int = 30  # whose mean is the plane of the water: some periods of the waves
    lidar_only_level_gain: float = 0.2  # of the tilt off the water, taken back with every cloud; averages waves out
    lidar_only_height_gain: float = 0.4  # the same of the height

    # Obstacle detection: cells that stand out of the water.
    cell_m: float = 0.5
    detect_nearest_m: float = 2.5  # nearer is the vessel itself, and spray
    detect_lowest_m: float = -1.2  # heights of obstacles beyond the water's returns: a degree of pitch is 0.5 m at 30 m
    detect_highest_m: float = 2.5
    detect_knots: int = 5  # poses a cloud, between which points are interpolated
    reach_rings: int = 24  # of 1 m, in which returns of water are counted
    reach_sectors: int = 14  # over 70 degrees, the lidar's view
    reach_sector_deg: float = 5.0
    reach_low_m: float = 0.35  # from the mean water: a point may be of the water
    reach_forget_gain: float = 0.9  # of the counts, from cloud to cloud
    reach_count: float = 0.8  # a sector with more is wet
    reach_wet_share: float = 0.45  # of the sectors: the ring is water
    reach_initial_m: float = 20.0  # before
    reach_learnt_clouds: int = 20  # were seen
    reach_beyond_m: float = 2.0  # the last ring of water
    reach_shrink_m: float = 0.03  # a cloud at most: waves that are seen far off come and go
    reach_grow_m: float = 0.05  # a cloud at most: a boom across the view looks like water at first
    stands_out_m: float = 0.2  # above the waves' spread, to be no water within reach
    bright_points: int = 30  # low ones, needed to say how bright water is
    bright_step: float = 3.0  # of 150 for all light, above water's median: wood and hide reflect more
    bright_nearest_m: float = 8.0  # nearer, water glints
    float_level_s: float = 15.0  # time constant of the height at which the vessel floats: heave takes seconds
    float_level_off_m: float = 0.4  # that height is never farther from the present one

    # Segmentation of cells into clusters.
    cluster_join_m: float = 1.0  # cells of this size that touch belong together
    cluster_frames: int = 2  # a cell seen in one frame alone is a drop of spray or a glint
    cluster_points: int = 3
    cluster_points_per_m: float = 5.0  # within doubtful water, where crests glint

    # Structure: too long to drift (boom, banks, dam).
    structure_kept_ns: int = 600_000_000_000
    structure_unseen_ns: int = 2_500_000_000  # a cell in view that is not hit for so long is not there
    structure_settled_ns: int = 1_500_000_000  # a cell counts when it was hit over so long,
    structure_settled_hits: int = 6  # so often
    structure_wet_ns: int = 8_000_000_000  # the same where water returns
    structure_wet_hits: int = 40
    structure_wet_kept_ns: int = 20_000_000_000
    wet_hit_ns: int = 280_000_000  # and there so often on the mean: crests come and go, structure is hit at every look
    strewn_share: float = 1.4  # of the water's reach: single crests return light up to here
    structure_view_deg: float = 28.0  # to either side
    structure_far_m: float = 100.0

    # Tracking of what drifts.
    track_longest_m: float = 9.0  # a longer cluster is structure: a trunk is 8 m at most
    track_beside_m: float = 2.0  # of structure: belongs to it
    track_gate_m: float = 2.5
    track_hits: int = 4  # to be confirmed,
    track_confirmed_ns: int = 700_000_000  # over so long
    track_wet_hits: int = 20  # the same for what is first seen where water returns, or not far beyond
    track_bright_points: int = 4  # brighter than water: it is something else, and
    track_bright_hits: int = 6  # confirm it
    track_odd_mps: float = 1.0  # off the water's drift: takes
    track_odd_hits: int = 12  # more hits
    track_odd_wet_mps: float = 0.6
    track_lost_ns: int = 2_500_000_000  # in view and not seen, and
    track_looked_for_ns: int = 100_000_000  # more for every hit, up to
    track_looked_for_most_ns: int = 6_000_000_000  # this: waves hide what is low
    track_doubtful_ns: int = 1_200_000_000  # the same before it is confirmed, in water
    track_doubtful_far_ns: int = 1_500_000_000  # and beyond water
    track_coasted_ns: int = 12_000_000_000  # out of view, at most,
    track_coasts_ns: int = 700_000_000  # and for every hit
    track_born_m: float = 8.0  # nothing is first seen closer: the bow's wave, and crests that it has run over
    track_view_deg: float = 29.0  # to either side
    track_view_m: float = 45.0
    track_start_mps: float = 0.4  # standard deviation of a new track's velocity
    track_drive_m2ps3: float = 0.01  # how fast velocities wander
    track_crest_gain: float = 9.0  # of the variance, among returns of water
    track_shrink_gain: float = 0.99  # of the remembered size, a look
    track_fastest_mps: float = 2.5
    track_grows_m: float = 3.0  # from one look to the next, where it was no structure and would be, or the other way

    # Other vessels: what moves as a whole. Chosen on vessels of 2 to 40 m that are met at 0.8 to 2.5 m/s in open water.
    outline_view_m: float = 55.0  # ends farther off may be those of the lidar's range
    outline_shortest_ns: int = 2_000_000_000  # between two looks that are compared
    outline_longest_ns: int = 4_000_000_000
    outline_least_m: float = 1.5  # three cells: its middle has gone so far,
    outline_least_mps: float = 0.5  # so fast,
    outline_share: float = 0.6  # and both its ends this much of it,
    outline_nearer: float = 0.5  # one end alone: it has come nearer by this share of its way,
    outline_looks: int = 3  # so often in a row
    outline_off_mps: float = 0.4  # a velocity farther off than this is replaced by the outline's
    outline_rest_mps: float = 0.2  # slower, it moves no more
    vessel_m: float = 7.0  # longer than what drifts, but for trunks
    vessel_grows_m: float = 6.0  # a longer cluster is no part of it
    vessel_place_m: float = 0.6  # standard deviation of its edge: a cell and what it goes while a cluster is gathered
    vessel_shrink_gain: float = 0.998  # of the remembered size, a look: for long only a part is seen
    vessel_slender: float = 4.0  # length of one by its beam, at least, while only its bow or its stern is seen
    vessel_fastest_mps: float = 15.0
    vessel_coasted_ns: int = 25_000_000_000  # out of view; it keeps its course better than what drifts

    # Obstacle avoidance: when detection and tracking run, and when a path counts as blocked.
    look_ns: int = 180_000_000  # from one clustering to the next
    look_waiting_clouds: int = 4  # held until their pose has come
    look_structure_m: float = 50.0
    look_stale_ns: int = 2_000_000_000  # without clouds for so long nothing is known to be free
    begin_share: float = 0.6  # of AVD_MARGIN: a path with less clearance is blocked
    doubtful_share: float = 1.6  # of the water's reach

    # Vessel model of the simulated courses.
    course_lookahead_m: float = 6.0
    course_turn_gain_per_s: float = 1.2  # turn rate per course still to be turned
    course_turn_degps: float = 22.0
    course_acceleration_mps2: float = 0.6
    course_reached_m: float = 3.0
    course_current_mps: float = 0.3  # a current that counts in full
    course_slowest_turn: float = 0.25  # of the speed asked for, with the bow far off

    # Avoidance course: candidates and costs.
    plan_courses_deg: float = 120.0  # to either side of the leg,
    plan_courses_step_deg: float = 10.0  # so far apart
    plan_holds_s: tuple[float, ...] = (1.6, 3.2, 6.0, 10.0)
    plan_speeds: tuple[float, ...] = (1.0, 0.45)  # of the mission's
    plan_far_m: float = 60.0
    plan_farther: float = 1.5  # times the horizon: how far ahead courses are compared
    plan_worth: float = 0.3  # of the way the mission would make in that time: less is not worth leaving it for,
    plan_leaving_worth: float = 0.45  # nor leaving a stop for
    plan_gain_share: float = 0.5  # of what is left of the path, where that is short
    plan_leaving_cost: float = 1.0  # of any course but the legs': equally good is no reason to leave them
    plan_lee_cost: float = 6.0  # for each metre of mean distance down the current
    plan_lee_margins: float = 2.0  # water to structure in the lee, in margins
    plan_lee_short_cost: float = 2.0
    plan_retreats_m: tuple[float, ...] = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0)
    plan_retreat_mps: float = 1.2
    plan_touch_m: float = 0.8  # nearer is as good as a collision
    plan_spread_mps: float = 0.06  # uncertainty of a track's drift
    plan_stray_mps: float = 0.15  # of a track out of view
    plan_stray_most_m: float = 1.5
    plan_structure_points: int = 400

    # Command output.
    blocked_plans: int = 2  # in a row, before control is taken
    blocked_far_plans: int = 8  # the same where the collision is not
    blocked_soon_s: float = 8.0  # so soon
    free_plans: int = 4  # in a row, before the mission gets control back
    freer_m: float = 0.5  # than what begins a detour
    back_m: float = 1.2  # off the leg: it is back on it
    back_deg: float = 20.0
    end_m: float = 6.0  # before the leg's end there is no leg left to come back to
    moved_m: float = 3.0  # a better place to wait is taken when it is so far off


TUNED = PerceptionTuning()
