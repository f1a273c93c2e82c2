"""Failsafes: what is watched, and when it counts. What is done about it is the autopilot's."""

from __future__ import annotations

import math

from agent.fcu.parameters import Parameters
from agent.fcu.sensing.position_filter import InnovationRatios

NONE, RTL_OR_HOLD, HOLD, DISARM, LOITER_OR_HOLD = 0, 1, 2, 5, 6  # FS_ACTION
WITHOUT_SMART = {3: RTL_OR_HOLD, 4: HOLD}  # there is no SmartRTL; its second choice is taken
_EKF_BAD_NS = 1_000_000_000
_FIRST_FIX_NS = 3_000_000_000  # after a silence of all sensors the first fix comes later than the first IMU sample


class Watch:
    """A condition that counts once it has lasted; `active` while it counts."""

    def __init__(self) -> None:
        self.active = False
        self._since_ns: int | None = None

    def changed(self, bad: bool, now_ns: int, after_ns: int) -> bool:
        """Note how it is; whether `active` has just changed."""
        if not bad:
            self._since_ns = None
            was, self.active = self.active, False
            return was
        if self._since_ns is None or now_ns < self._since_ns:
            self._since_ns = now_ns
        if self.active or now_ns - self._since_ns < after_ns:
            return False
        self.active = True
        return True


class Failsafes:
    """The watches. Each method takes one look and says whether its watch has just changed."""

    def __init__(self, parameters: Parameters) -> None:
        self.imu = Watch()
        self.ekf = Watch()
        self.gcs = Watch()
        self._parameters = parameters
        self._imu_accepted = 0
        self._imu_seen_ns: int | None = None
        self._imu_back_ns: int | None = None
        self._gcs_heard_ns: int | None = None
        self.configure()

    def configure(self) -> None:
        """Take changed parameters over."""
        p = self._parameters
        self.imu_timeout_s = p["FS_IMU_TIMEOUT"]
        self.gcs_timeout_s = p["FS_GCS_TIMEOUT"]
        self._lasting_ns = int(p["FS_TIMEOUT"] * 1e9)
        self._gcs_enabled = p["FS_GCS_ENABLE"] >= 1.0
        self._gcs_system = int(p["SYSID_MYGCS"])
        self._ekf_threshold = p["FS_EKF_THRESH"]

    @property
    def active(self) -> tuple[str, ...]:
        """Names of what is in force."""
        named = (("IMU", self.imu), ("EKF", self.ekf), ("GCS", self.gcs))
        return tuple(name for name, watch in named if watch.active)

    def heard_ground_station(self, system_id: int, now_ns: int) -> None:
        """A heartbeat; counts when it is SYSID_MYGCS's."""
        if self._gcs_system in (0, system_id):
            self._gcs_heard_ns = now_ns

    def look_at_imu(self, accepted: int, armed: bool, now_ns: int) -> bool:
        """`accepted` counts samples. Silence counts once there was a sample, or when armed."""
        if accepted != self._imu_accepted or self._imu_seen_ns is None:
            self._imu_accepted = accepted
            self._imu_seen_ns = now_ns
        silent = now_ns - self._imu_seen_ns > self.imu_timeout_s * 1e9 and (accepted > 0 or armed)
        changed = self.imu.changed(silent, now_ns, 0)
        if changed:
            self._imu_back_ns = None if silent else now_ns
        return changed

    def look_at_ekf(self, lost: bool, ratios: InnovationRatios, steering_by_it: bool, now_ns: int) -> bool:
        """Bad when the position is lost, at once; or after a second of test ratios that ArduPilot calls bad.

        Not while the IMU is silent, when outputs are neutral anyway, nor just after: what is steered then goes on with
        the first fix.
        """
        if not steering_by_it and not self.ekf.active:
            return False
        back_ns = self._imu_back_ns
        if self.imu.active or (back_ns is not None and 0 <= now_ns - back_ns < _FIRST_FIX_NS):
            return False
        after_ns = 0 if lost else _EKF_BAD_NS
        return self.ekf.changed(lost or self._is_over(ratios), now_ns, after_ns)

    def look_at_gcs(self, armed: bool, now_ns: int) -> bool:
        """Silence of a station that was heard before, for FS_GCS_TIMEOUT and then FS_TIMEOUT."""
        heard_ns = self._gcs_heard_ns
        silent = (
            self._gcs_enabled
            and heard_ns is not None
            and (armed or self.gcs.active)
            and now_ns - heard_ns >= self.gcs_timeout_s * 1e9
        )
        return self.gcs.changed(silent, now_ns, self._lasting_ns)

    def _is_over(self, ratios: InnovationRatios) -> bool:
        """ArduPilot's ekf_over_threshold: position and one more, or two of velocity (twice when far over), compass."""
        limit = self._ekf_threshold
        if limit <= 0.0:
            return False
        velocity, heading = math.sqrt(ratios.velocity), math.sqrt(ratios.heading)
        over = (heading >= limit) + (velocity >= limit) + (velocity >= 2.0 * limit)
        return over >= 2 or (over >= 1 and ratios.position >= limit * limit)
