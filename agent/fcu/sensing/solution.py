"""What the estimator knows, how it is read, and whether it is fit to be armed on."""

from __future__ import annotations

from agent.fcu.local_frame import STANDARD_GRAVITY_MPS2, LocalFrame
from agent.fcu.parameters import Parameters
from agent.fcu.samples import Estimate, Vector3
from agent.fcu.sensing.alignment import Alignment
from agent.fcu.sensing.attitude_aid import AttitudeAid
from agent.fcu.sensing.barometer_height import BarometerHeight
from agent.fcu.sensing.fixes import TiltReference
from agent.fcu.sensing.history import History
from agent.fcu.sensing.inertial import InertialState, cross, euler, frd_to_ned
from agent.fcu.sensing.position_filter import InnovationRatios, PositionFilter

_ZERO: Vector3 = (0.0, 0.0, 0.0)
_SECOND_NS = 1_000_000_000
_DEAD_RECKONING_NS = 5 * _SECOND_NS
_SETTLE_NS = 8 * _SECOND_NS


class Solution:
    """The state that samples are fused into; who fuses them is the `Estimator`. `frame` is None before the first fixes.

    refused: samples that could not be true. restarts: how often all was begun anew.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.refused: dict[str, int] = {"imu": 0, "gnss": 0, "magnetometer": 0, "barometer": 0}
        self.restarts = 0
        self._parameters = parameters
        self._begin()

    def configure(self) -> None:
        """Take changed parameters over."""
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
        self._attitude.configure(p["AHRS_RP_P"], p["AHRS_YAW_P"])
        self._filter.configure(p)

    def _begin(self) -> None:
        p = self._parameters
        self.frame: LocalFrame | None = None
        self._alignment = Alignment()
        self._attitude = AttitudeAid(p["AHRS_RP_P"], p["AHRS_YAW_P"])
        self._filter = PositionFilter(p)
        self.configure()
        self._state: InertialState | None = None
        self._history = History()
        self._acceleration_bias_ned: Vector3 = _ZERO
        self._gravity_mps2 = STANDARD_GRAVITY_MPS2
        self._stamps_refused = 0
        self._levelled_ns = 0
        self._housekeeping_ns = 0
        self._fix: TiltReference | None = None
        self._fix_arrived_ns = 0  # by the newest IMU stamp then, since a fix may be late by any time
        self._fix_used_ns: int | None = None
        self._fix_seen_ns: int | None = None
        self._fix_usable = False
        self._origin_fixes: list[tuple[float, float, float]] = []
        self._heading_ns: int | None = None
        self._heading_used_ns: int | None = None
        self._barometer = BarometerHeight()

    # -- reading

    @property
    def ratios(self) -> InnovationRatios:
        """Test ratios of the last innovations."""
        return self._filter.ratios

    @property
    def gyro_bias_frd_radps(self) -> Vector3:
        """Estimated gyro bias."""
        return self._attitude.bias_frd_radps

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample in use, 0 before the first attitude."""
        return 0 if self._state is None else self._state.stamp_ns

    def position_valid(self) -> bool:
        """Whether a fix was used in the last five seconds: dead reckoning is believed that long."""
        return (
            self._state is not None
            and self._fix_used_ns is not None
            and self._state.stamp_ns - self._fix_used_ns <= _DEAD_RECKONING_NS
        )

    def estimate(self) -> Estimate:
        """The body origin at the newest IMU sample; all zero and not valid before the first attitude."""
        state = self._state
        if state is None:
            return Estimate(0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, _ZERO, _ZERO, _ZERO, False, False)
        stamp_ns, w, x, y, z, vn, ve, vd, pn, pe, pd = state[:11]
        rate = self._rate_frd(state)
        if self._imu_is_offset:
            arm_n, arm_e, arm_d = frd_to_ned(state, self._imu_frd_m)
            swing_n, swing_e, swing_d = frd_to_ned(state, cross(rate, self._imu_frd_m))
            pn, pe, pd = pn - arm_n, pe - arm_e, pd - arm_d
            vn, ve, vd = vn - swing_n, ve - swing_e, vd - swing_d
        roll_rad, pitch_rad, yaw_rad = euler(w, x, y, z)
        return Estimate(
            stamp_ns,
            (w, x, y, z),
            roll_rad,
            pitch_rad,
            yaw_rad,
            rate,
            (pn, pe, pd),
            (vn, ve, vd),
            self._heading_used_ns is not None,
            self.position_valid(),
        )

    def problems(self) -> tuple[str, ...]:
        """Why the estimate is not to be armed on, each by name; empty when it is ready."""
        state = self._state
        if state is None:
            return ("AHRS: levelling",)
        found = []
        now_ns = state.stamp_ns
        if now_ns - self._levelled_ns < _SETTLE_NS:
            found.append("AHRS: settling")
        if self._heading_ns is None or now_ns - self._heading_ns > _SECOND_NS:
            found.append("Compass: no data")
        elif self._filter.ratios.heading > 1.0:
            found.append("Compass: inconsistent with gyro")
        if self._fix_seen_ns is None or now_ns - self._fix_seen_ns > 2 * _SECOND_NS:
            found.append("GPS: no data")
        elif not self._fix_usable:
            found.append("GPS: no usable fix")
        elif not self.position_valid():
            found.append("EKF: no position")
        elif max(self._filter.ratios[:3]) > 1.0:
            found.append("EKF: GPS innovations too large")
        if self._barometer.stamp_ns is None or now_ns - self._barometer.stamp_ns > _SECOND_NS:
            found.append("Baro: no data")
        return tuple(found)

    def _rate_frd(self, state: InertialState) -> Vector3:
        bx, by, bz = self._attitude.bias_frd_radps
        return (state.gyro_x_radps - bx, state.gyro_y_radps - by, state.gyro_z_radps - bz)
