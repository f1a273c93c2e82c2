"""Estimator (LS): attitude, gyro bias, position and velocity from IMU, GNSS, magnetometer and barometer.

Attitude is an explicit complementary filter on SO(3) with gyro bias (Mahony, Hamel and Pflimlin 2008, eq 32). The gyro
is integrated and slowly corrected toward two references. Waves and turns disturb the accelerometer, so it is not the
only vertical reference. Accelerometer and attitude predict the velocity change between two GNSS fixes, which is
compared with the measured one. The heading reference is the horizontal magnetic field and COMPASS_DEC.

Position and velocity are integrated at the IMU's rate. A Kalman filter per axis corrects them at the instant of the
fix. The innovation is computed with the stored state at the sample's stamp, and the correction is propagated forward.

The estimator holds state, unlike guidance and control, because a history at 200 Hz is not copied per sample.
"""

from __future__ import annotations

import math

from agent.navigation.attitude import (
    AttitudeCorrection,
    InitialAlignment,
    TiltReference,
    heading_error_rad,
    turn_heading,
)
from agent.navigation.geodetic import STANDARD_GRAVITY_MPS2, LocalProjection, normal_gravity_mps2
from agent.navigation.heading_filter import HeadingFilter
from agent.navigation.inertial import (
    InertialHistory,
    InertialState,
    StateCorrection,
    cross,
    euler,
    frd_to_ned,
    propagate,
    shift_state,
)
from agent.navigation.measurements import (
    ArmingProblem,
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    StateEstimate,
    Vector3,
)
from agent.navigation.parameters import EstimatorParameters
from agent.navigation.position_filter import (
    PRESSURE_RANGE_PA,
    BarometerHeight,
    EstimateVariances,
    InnovationRatios,
    PositionFilter,
)

_ZERO: Vector3 = (0.0, 0.0, 0.0)
_SECOND_NS = 1_000_000_000
_GYRO_LIMIT2 = 35.0**2  # 2000 deg/s
_ACCEL_LIMIT2 = 160.0**2  # 16 g
_FIELD_LIMITS2_GAUSS2 = (0.1**2, 1.2**2)  # the Earth's field is 0.22 to 0.67 gauss
_LEAST_GAUSS = 0.05  # horizontal
_ACCURACY_LIMIT_M = 10.0
_GAP_NS = _SECOND_NS // 4  # the attitude is not integrated across a longer gap without IMU samples
_JUMP_NS = 60 * _SECOND_NS
_RESTART_AFTER = 200  # consecutive samples refused for their stamps: the clock was set
_HOUSEKEEPING_NS = _SECOND_NS // 5
_FIX_TIMEOUT_NS = 6 * _SECOND_NS // 10
_COMPASS_TIMEOUT_NS = _SECOND_NS // 2
_RESET_NS = 5 * _SECOND_NS
_ORIGIN_FIXES = 5
_HEADING_GATE_RAD = 0.5
_TRUST_WITHOUT_FIX = 0.25
_DEAD_RECKONING_NS = 5 * _SECOND_NS
_SETTLE_NS = 8 * _SECOND_NS
_SPEED_LIMIT2 = 100.0**2


class Estimator:
    """Fuses measurements into `estimate()`. `frame` is None before the first fixes.

    refused: number of implausible measurements, by sensor; `on_...` returns False for each.
    restarts: number of restarts of the estimator.
    imu_accepted: number of accepted IMU samples.
    """

    def __init__(self, parameters: EstimatorParameters) -> None:
        self.refused: dict[str, int] = {"imu": 0, "gnss": 0, "magnetometer": 0, "barometer": 0}
        self.restarts = 0
        self.imu_accepted = 0
        self._parameters = parameters
        self._restart()

    def configure(self) -> None:
        """Apply changed parameters."""
        p = self._parameters
        self._declination_rad = p["COMPASS_DEC"]
        self._compass_offset_gauss = tuple(1e-3 * p[f"COMPASS_OFS_{axis}"] for axis in "XYZ")
        self._imu_frd_m: Vector3 = (p["INS_POS1_X"], p["INS_POS1_Y"], p["INS_POS1_Z"])
        self._imu_is_offset = self._imu_frd_m != _ZERO
        antenna = (p["GPS1_POS_X"], p["GPS1_POS_Y"], p["GPS1_POS_Z"])
        self._antenna_from_imu_frd_m: Vector3 = (
            antenna[0] - self._imu_frd_m[0],
            antenna[1] - self._imu_frd_m[1],
            antenna[2] - self._imu_frd_m[2],
        )
        self._least_satellites = p["AHRS_GPS_MINSATS"]
        self._attitude.configure(p["AHRS_RP_P"])
        self._heading.configure(p)
        self._filter.configure(p)

    def _restart(self) -> None:
        p = self._parameters
        self.frame: LocalProjection | None = None
        self._alignment = InitialAlignment()
        self._attitude = AttitudeCorrection(p["AHRS_RP_P"])
        self._heading = HeadingFilter(p)
        self._filter = PositionFilter(p)
        self.configure()
        self._state: InertialState | None = None
        self._history = InertialHistory()
        self._acceleration_bias_ned: Vector3 = _ZERO
        self._gravity_mps2 = STANDARD_GRAVITY_MPS2
        self._stamps_refused = 0
        self._levelled_ns = 0
        self._housekeeping_ns = 0
        self._fix: TiltReference | None = None
        self._fix_arrived_ns = 0  # newest IMU stamp at that instant, because a fix may have any delay
        self._fix_used_ns: int | None = None
        self._fix_seen_ns: int | None = None
        self._fix_problem = "GPS 1: Bad fix"
        self._origin_fixes: list[tuple[float, float, float]] = []
        self._heading_ns: int | None = None
        self._heading_used_ns: int | None = None
        self._barometer = BarometerHeight()

    # -- IMU

    def on_imu(self, sample: ImuMeasurement) -> bool:
        """Integrate an IMU sample."""
        gx, gy, gz = sample.gyro_frd_radps
        fx, fy, fz = sample.accel_frd_mps2
        # The form of the comparison fails for NaN and infinity.
        if not (gx * gx + gy * gy + gz * gz < _GYRO_LIMIT2 and fx * fx + fy * fy + fz * fz < _ACCEL_LIMIT2):
            self.refused["imu"] += 1
            return False
        state = self._state
        if state is None:
            return self._align(sample)
        step_ns = sample.stamp_ns - state.stamp_ns
        if not 0 < step_ns <= _GAP_NS:
            return self._resume(state, sample, step_ns)
        self._stamps_refused = 0
        self._state = state = propagate(
            state, sample, self._attitude.rate_offset_frd_radps, self._acceleration_bias_ned, self._gravity_mps2
        )
        self._history.append(state)
        if sample.stamp_ns >= self._housekeeping_ns:
            self._update_slowly(state)
        self.imu_accepted += 1
        return True

    def _align(self, sample: ImuMeasurement) -> bool:
        """Average until the initial attitude is available."""
        state = self._alignment.add(sample, self._declination_rad)
        if state is not None:
            self._state = state
            self._history.restart(state)
            self._levelled_ns = state.stamp_ns
            self._housekeeping_ns = state.stamp_ns + _HOUSEKEEPING_NS
            if self._alignment.field_frd_gauss is not None:
                self._heading_used_ns = state.stamp_ns
                self._restart_heading(state, self._alignment.field_frd_gauss)
        self.imu_accepted += 1
        return True

    def _resume(self, state: InertialState, sample: ImuMeasurement, step_ns: int) -> bool:
        """Continue from the last attitude after a gap.

        Refuse any other stamp, and restart after 200 consecutive refusals.
        """
        if not 0 < step_ns <= _JUMP_NS:
            self.refused["imu"] += 1
            self._stamps_refused += 1
            if self._stamps_refused >= _RESTART_AFTER:
                self.restarts += 1
                self._restart()
            return False
        gap_s = step_ns * 1e-9
        travelled = (state.vel_north_mps * gap_s, state.vel_east_mps * gap_s, 0.0)
        gx, gy, gz = sample.gyro_frd_radps
        moved = shift_state(state, _ZERO, travelled)
        self._state = moved._replace(stamp_ns=sample.stamp_ns, gyro_x_radps=gx, gyro_y_radps=gy, gyro_z_radps=gz)
        self._history.restart(self._state)
        self._fix = None
        self._filter.loosen(gap_s)
        self._heading.loosen(gap_s)
        self._levelled_ns = sample.stamp_ns  # use high gains again
        self.imu_accepted += 1
        return True

    def _update_slowly(self, state: InertialState) -> None:
        """Settle the gains, and continue without GNSS or compass when they have no data. Called five times a second."""
        stamp_ns = state.stamp_ns
        self._housekeeping_ns = stamp_ns + _HOUSEKEEPING_NS
        self._attitude.settle((stamp_ns - self._levelled_ns) * 1e-9)
        if self._heading_ns is None or stamp_ns - self._heading_ns > _COMPASS_TIMEOUT_NS:
            self._attitude.drop_heading()
            self._heading.stop(stamp_ns)
        if self._fix is not None and stamp_ns - self._fix_arrived_ns <= _FIX_TIMEOUT_NS:
            return
        # Without a measured velocity change, assume that there is none.
        before = self._history.recent()
        dt_s = (stamp_ns - before.stamp_ns) * 1e-9
        if dt_s > 0.05:
            north_mps2 = (state.sum_north_mps - before.sum_north_mps) / dt_s
            east_mps2 = (state.sum_east_mps - before.sum_east_mps) / dt_s
            self._tilt(state, north_mps2, east_mps2, _HOUSEKEEPING_NS * 1e-9, _TRUST_WITHOUT_FIX)

    def _tilt(self, state: InertialState, north_mps2: float, east_mps2: float, dt_s: float, trust: float) -> None:
        """Correct the tilt.

        Acceleration that the attitude predicts but that did not occur is gravity under a tilt error.
        """
        self._attitude.tilt(state, east_mps2 / self._gravity_mps2, -north_mps2 / self._gravity_mps2, dt_s, trust)

    # -- GNSS

    def on_gnss(self, sample: GnssMeasurement) -> bool:
        """Fuse a fix at its own instant."""
        state = self._state
        in_order = self._fix_seen_ns is None or sample.stamp_ns > self._fix_seen_ns
        if not (in_order and _is_plausible(sample)) or _is_ahead(sample.stamp_ns, state):
            self.refused["gnss"] += 1
            return False
        if state is None:
            return True
        self._fix_seen_ns = sample.stamp_ns
        self._fix_problem = ""
        if sample.fix_type < 3:
            self._fix_problem = "GPS 1: Bad fix"
        elif sample.satellites < self._least_satellites:
            self._fix_problem = f"AHRS: GPS numsats {sample.satellites} (needs {self._least_satellites:g})"
        elif not sample.horizontal_accuracy_m <= _ACCURACY_LIMIT_M:
            accuracy_m = sample.horizontal_accuracy_m
            self._fix_problem = f"AHRS: GPS horiz error {accuracy_m:.1f}m (needs {_ACCURACY_LIMIT_M:.1f})"
        then = self._history.state_at(sample.stamp_ns)
        if then is not None and not self._fix_problem:
            self._fuse_fix(then, sample)
        return True

    def _fuse_fix(self, then: InertialState, sample: GnssMeasurement) -> None:
        arm_frd = self._antenna_from_imu_frd_m
        vn, ve, vd = sample.vel_ned_mps
        arm_n, arm_e, arm_d = frd_to_ned(then, arm_frd)
        swing_n, swing_e, swing_d = frd_to_ned(then, cross(self._rate_frd(then), arm_frd))
        measured_vel = (vn - swing_n, ve - swing_e, vd - swing_d)

        if self.frame is None:
            self._origin_fixes.append((sample.lat_deg, sample.lon_deg, sample.alt_m))
            if len(self._origin_fixes) < _ORIGIN_FIXES:
                self._tilt_from(TiltReference.from_fix(then, sample.stamp_ns, measured_vel))
                return
            first_lon = self._origin_fixes[0][1]
            lat, lon, alt = (sum(column) / _ORIGIN_FIXES for column in zip(*self._origin_fixes))
            # A mean across the date line would be on the other side of the Earth.
            self._start_frame(lat, lon if abs(lon - first_lon) < 1.0 else first_lon, alt)
        frame = self.frame
        assert frame is not None
        north, east = frame.to_local(sample.lat_deg, sample.lon_deg)
        late_s = (sample.stamp_ns - then.stamp_ns) * 1e-9
        pos_innovation = (
            north - arm_n - then.north_m - late_s * then.vel_north_mps,
            east - arm_e - then.east_m - late_s * then.vel_east_mps,
            frame.alt_m - sample.alt_m - arm_d - then.down_m - late_s * then.vel_down_mps,
        )
        vel_innovation = (
            measured_vel[0] - then.vel_north_mps - late_s * then.acc_north_mps2,
            measured_vel[1] - then.vel_east_mps - late_s * then.acc_east_mps2,
            measured_vel[2] - then.vel_down_mps - late_s * then.acc_down_mps2,
        )
        stamp_ns = sample.stamp_ns
        accuracy = (sample.horizontal_accuracy_m, sample.vertical_accuracy_m, sample.speed_accuracy_mps)
        if self._fix_used_ns is None or stamp_ns - self._fix_used_ns > _RESET_NS:
            self._filter.restart(accuracy)
            self._apply(StateCorrection(pos_innovation, vel_innovation, _ZERO), stamp_ns)
            self._fix_used_ns = stamp_ns
            self._fix = None
            return
        reference = TiltReference.from_fix(then, stamp_ns, measured_vel)
        acceleration = reference.accelerated(self._fix)
        correction = self._filter.fuse_gnss(stamp_ns, pos_innovation, vel_innovation, accuracy, acceleration)
        self._apply(correction, stamp_ns)
        ratios = self._filter.ratios
        if ratios.position <= 1.0 and ratios.velocity <= 1.0:
            self._fix_used_ns = stamp_ns
        if ratios.velocity <= 1.0:
            self._tilt_from(reference)
        else:
            self._fix = None
        if ratios.height <= 1.0:
            self._barometer.calibrate(sample.alt_m, stamp_ns)

    def _tilt_from(self, fix: TiltReference) -> None:
        """Compare the velocity change since the last fix with the prediction of the attitude."""
        last, self._fix = self._fix, fix
        self._fix_arrived_ns = self.stamp_ns
        unexplained = None if last is None else fix.unexplained(last)
        if unexplained is not None and self._state is not None:
            self._tilt(self._state, *unexplained, 1.0)

    def _apply(self, correction: StateCorrection, stamp_ns: int) -> None:
        """Correct the state, the stored states and the acceleration bias."""
        self._state = self._history.correct(correction, stamp_ns)
        bias, change = self._acceleration_bias_ned, correction.bias_ned_mps2
        self._acceleration_bias_ned = (bias[0] + change[0], bias[1] + change[1], bias[2] + change[2])

    # -- magnetometer

    def on_magnetometer(self, sample: MagnetometerMeasurement) -> bool:
        """Fuse a field vector: heading error against the stored attitude."""
        offset_x, offset_y, offset_z = self._compass_offset_gauss
        mx, my, mz = sample.field_frd_gauss
        field = (mx + offset_x, my + offset_y, mz + offset_z)
        total2 = field[0] * field[0] + field[1] * field[1] + field[2] * field[2]
        last_ns = self._heading_ns
        state = self._state
        if (
            not _FIELD_LIMITS2_GAUSS2[0] < total2 < _FIELD_LIMITS2_GAUSS2[1]
            or (last_ns is not None and sample.stamp_ns <= last_ns)
            or _is_ahead(sample.stamp_ns, state)
        ):
            self.refused["magnetometer"] += 1
            return False
        if state is None:
            self._alignment.field_frd_gauss = field
            return True
        then = self._history.state_at(sample.stamp_ns)
        if then is None:
            return True
        self._heading_ns = sample.stamp_ns
        north, east, down = frd_to_ned(then, field)
        if north * north + east * east < _LEAST_GAUSS * _LEAST_GAUSS:
            return True
        error_rad = heading_error_rad(then, field, self._declination_rad)
        ratio = (error_rad / _HEADING_GATE_RAD) ** 2
        self._filter.ratios = self._filter.ratios._replace(heading=ratio)
        used_ns = self._heading_used_ns
        if used_ns is None or sample.stamp_ns - used_ns > _RESET_NS:
            # Set the heading. The stored accelerations and sums are no longer valid.
            self._state = turn_heading(state, error_rad)
            self._history.restart(self._state)
            self._fix = None
            self._heading_used_ns = sample.stamp_ns
            self._restart_heading(self._state, field)
        elif ratio <= 1.0 and self._heading.add(sample.stamp_ns, error_rad):
            course_rad = euler(*then[1:5])[2] - self._declination_rad
            correction = self._heading.correct(sample.stamp_ns, course_rad, math.hypot(north, east), down)
            if correction is None:
                self._attitude.drop_heading()
            else:
                self._attitude.turn(state, *correction)
                self._heading_used_ns = sample.stamp_ns
        return True

    def _restart_heading(self, state: InertialState, field_frd_gauss: Vector3) -> None:
        """Begin the heading filter after the heading was set to the compass."""
        north, east, _ = frd_to_ned(state, field_frd_gauss)
        course_rad = euler(*state[1:5])[2] - self._declination_rad
        self._heading.restart(state.stamp_ns, course_rad, max(math.hypot(north, east), _LEAST_GAUSS))

    # -- barometer

    def on_barometer(self, sample: BarometerMeasurement) -> bool:
        """Fuse a pressure, as a second height in addition to the GNSS height."""
        state = self._state
        last_ns = self._barometer.stamp_ns
        if (
            not PRESSURE_RANGE_PA[0] < sample.pressure_pa < PRESSURE_RANGE_PA[1]
            or (last_ns is not None and sample.stamp_ns <= last_ns)
            or _is_ahead(sample.stamp_ns, state)
        ):
            self.refused["barometer"] += 1
            return False
        if state is None:
            return True
        alt_m = self._barometer.add(sample)
        if alt_m is not None and self.frame is not None and self._fix_used_ns is not None:
            correction = self._filter.fuse_height(sample.stamp_ns, self.frame.alt_m - alt_m - state.down_m)
            self._apply(correction, state.stamp_ns)
        return True

    # -- outputs

    @property
    def ratios(self) -> InnovationRatios:
        """Test ratios of the last innovations."""
        return self._filter.ratios

    def variances(self) -> EstimateVariances | None:
        """Variances of `estimate()`, None before the first fix in use. They grow without fixes."""
        state = self._state
        if state is None or self._fix_used_ns is None:
            return None
        variances = self._filter.variances(state.stamp_ns)
        heading_rad2 = math.nan if self._heading_used_ns is None else self._heading.variance_rad2(state.stamp_ns)
        return variances._replace(heading_rad2=heading_rad2)

    @property
    def gyro_bias_frd_radps(self) -> Vector3:
        """Estimated gyro bias."""
        return self._attitude.bias_frd_radps

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample in use, 0 before the first attitude."""
        return 0 if self._state is None else self._state.stamp_ns

    def position_valid(self) -> bool:
        """Whether a fix was used in the last five seconds, which is the limit of dead reckoning."""
        return (
            self._state is not None
            and self._fix_used_ns is not None
            and self._state.stamp_ns - self._fix_used_ns <= _DEAD_RECKONING_NS
        )

    def estimate(self) -> StateEstimate:
        """State of the body origin at the newest IMU sample. All zero and not valid before the initial attitude."""
        state = self._state
        if state is None:
            return StateEstimate(0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, _ZERO, _ZERO, _ZERO, False, False)
        stamp_ns, w, x, y, z, vn, ve, vd, pn, pe, pd = state[:11]
        rate = self._rate_frd(state)
        if self._imu_is_offset:
            arm_n, arm_e, arm_d = frd_to_ned(state, self._imu_frd_m)
            swing_n, swing_e, swing_d = frd_to_ned(state, cross(rate, self._imu_frd_m))
            pn, pe, pd = pn - arm_n, pe - arm_e, pd - arm_d
            vn, ve, vd = vn - swing_n, ve - swing_e, vd - swing_d
        roll_rad, pitch_rad, yaw_rad = euler(w, x, y, z)
        attitude_valid = self._heading_used_ns is not None
        return StateEstimate(
            stamp_ns, (w, x, y, z), roll_rad, pitch_rad, yaw_rad, rate, (pn, pe, pd), (vn, ve, vd),
            attitude_valid, self.position_valid(),
        )  # fmt: skip

    def problems(self) -> tuple[ArmingProblem, ...]:
        """Reasons against arming with this estimate. Empty when it is ready."""
        state = self._state
        if state is None:
            return (ArmingProblem("AHRS", "AHRS: EKF3 not started"),)
        problems = []
        now_ns, ratios = state.stamp_ns, self._filter.ratios
        if now_ns - self._levelled_ns < _SETTLE_NS:
            problems.append(ArmingProblem("AHRS", "AHRS: Not healthy"))
        if self._heading_ns is None or now_ns - self._heading_ns > _SECOND_NS:
            problems.append(ArmingProblem("Compass", "Compass not healthy"))
        elif ratios.heading > 1.0:
            problems.append(ArmingProblem("Compass", f"AHRS: Mag yaw error x={ratios.heading:.1f}"))
        if self._fix_seen_ns is None or now_ns - self._fix_seen_ns > 2 * _SECOND_NS:
            problems.append(ArmingProblem("GPS", "GPS 1: Bad fix"))
        elif self._fix_problem:
            problems.append(ArmingProblem("GPS", self._fix_problem))
        elif not self.position_valid():
            problems.append(ArmingProblem("EKF", "Need Position Estimate"))
        elif max(ratios[:3]) > 1.0:
            problems.append(ArmingProblem("EKF", "AHRS: EKF3 core 0 unhealthy"))
        if self._barometer.stamp_ns is None or now_ns - self._barometer.stamp_ns > _SECOND_NS:
            problems.append(ArmingProblem("Baro", "Baro: not healthy"))
        return tuple(problems)

    def set_origin(self, lat_deg: float, lon_deg: float, alt_m: float) -> bool:
        """Set the origin of local positions before the first fixes define it. Return False when it exists already."""
        if self.frame is not None:
            return False
        self._start_frame(lat_deg, lon_deg, alt_m)
        return True

    def _start_frame(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        self.frame = LocalProjection(lat_deg, lon_deg, alt_m)
        self._gravity_mps2 = normal_gravity_mps2(lat_deg)

    def _rate_frd(self, state: InertialState) -> Vector3:
        bx, by, bz = self._attitude.bias_frd_radps
        return (state.gyro_x_radps - bx, state.gyro_y_radps - by, state.gyro_z_radps - bz)


def _is_ahead(stamp_ns: int, state: InertialState | None) -> bool:
    """Whether a stamp is farther ahead of the IMU than message reordering can explain."""
    return state is not None and stamp_ns > state.stamp_ns + _GAP_NS


def _is_plausible(sample: GnssMeasurement) -> bool:
    """Whether the values are plausible for a boat. The comparisons fail for NaN and infinity."""
    vn, ve, vd = sample.vel_ned_mps
    return (
        abs(sample.lat_deg) <= 90.0
        and abs(sample.lon_deg) <= 180.0
        and abs(sample.alt_m) < 10_000.0
        and vn * vn + ve * ve + vd * vd < _SPEED_LIMIT2
        and 0.0 <= sample.horizontal_accuracy_m < 1e6
        and 0.0 <= sample.vertical_accuracy_m < 1e6
        and 0.0 <= sample.speed_accuracy_mps < 1e6
    )
