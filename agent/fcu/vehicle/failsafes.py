"""The watchkeeper: looks at failsafes and fence every cycle, acts, and says so; says too when it is over."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from agent.fcu.estimation.position_filter import InnovationRatios
from agent.fcu.fence import Fence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle_state import CRITICAL, NOTICE, WARNING

if TYPE_CHECKING:
    from agent.fcu.vehicle.autopilot import Autopilot

_FENCE_EVERY = 10  # cycles
_FURTHER_OUT_M = 20.0  # so much more, and the fence acts again
_CONTINUE_IN_AUTO = 2  # FS_GCS_ENABLE
_HOLD, _REPORT = 1, 2  # FS_EKF_ACTION
NONE, RTL_OR_HOLD, HOLD, DISARM, LOITER_OR_HOLD = 0, 1, 2, 5, 6  # FS_ACTION
WITHOUT_SMART = {3: RTL_OR_HOLD, 4: HOLD}  # there is no SmartRTL; its second choice is taken
_CHOICES = {
    NONE: (),
    RTL_OR_HOLD: (modes.RTL, modes.HOLD),
    HOLD: (modes.HOLD,),
    LOITER_OR_HOLD: (modes.LOITER, modes.HOLD),
}
_EKF_BAD_NS = 1_000_000_000
_FIRST_FIX_NS = 3_000_000_000  # after a silence of all sensors the first fix comes later than the first IMU sample


class FailsafeHandler:
    """Acts on an autopilot. A mode that was changed stays changed when the cause is over."""

    def __init__(
        self, autopilot: Autopilot, parameters: Parameters, boundary: Fence, failsafes: FailsafeMonitor
    ) -> None:
        self.failsafes = failsafes
        self._autopilot = autopilot
        self._parameters = parameters
        self._fence = boundary
        self._cycle = 0
        self._depth_m = 0.0

    def armed(self) -> None:
        """Who arms outside of the fence is told again."""
        self._fence.forget_breach()
        self._cycle = 0

    def look(self, imu_accepted: int, now_ns: int) -> None:
        """One cycle."""
        autopilot, watches = self._autopilot, self.failsafes
        if watches.look_at_imu(imu_accepted, autopilot.armed, now_ns):
            self._on_imu()
        position_valid = autopilot.estimate.position_valid
        steering_by_it = autopilot.armed and modes.BY_NUMBER[autopilot.mode].needs_position
        if watches.look_at_ekf(not position_valid, autopilot.estimator.ratios, steering_by_it, now_ns):
            self._on_ekf(position_valid)
        if watches.look_at_gcs(autopilot.armed, now_ns):
            self._on_gcs()
        if self._cycle == 0 and position_valid:
            self._look_at_fence(now_ns)
        self._cycle = (self._cycle + 1) % _FENCE_EVERY

    def _on_imu(self) -> None:
        if self.failsafes.imu.active:
            said = f"Failsafe: no IMU for {self.failsafes.imu_timeout_s:g} s, outputs neutral"
            self._autopilot.events.say(CRITICAL, said)
        else:
            self._autopilot.events.say(NOTICE, "Failsafe over: IMU is back, outputs go on")

    def _on_ekf(self, position_valid: bool) -> None:
        action = int(self._parameters["FS_EKF_ACTION"])
        if action not in (_HOLD, _REPORT):
            return
        if not self.failsafes.ekf.active:
            self._autopilot.events.say(NOTICE, "EKF failsafe over")
            return
        why = "EKF failsafe: estimate inconsistent" if position_valid else "EKF failsafe: position lost"
        self._act(why, (modes.HOLD,) if action == _HOLD else ())

    def _on_gcs(self) -> None:
        if not self.failsafes.gcs.active:
            self._autopilot.events.say(NOTICE, "GCS failsafe over: ground station is back")
            return
        why = f"GCS failsafe: no heartbeat for {self.failsafes.gcs_timeout_s:g} s"
        self._autopilot.manual.release()
        mode = self._autopilot.mode
        if mode == modes.AUTO and int(self._parameters["FS_GCS_ENABLE"]) == _CONTINUE_IN_AUTO:
            self._autopilot.events.say(WARNING, f"{why}, going on in AUTO")
            return
        action = int(self._parameters["FS_ACTION"])
        action = WITHOUT_SMART.get(action, action)
        if action == DISARM:
            self._autopilot.events.say(CRITICAL, f"{why}, disarming")
            self._autopilot.disarm()
        elif mode in (modes.HOLD, modes.RTL):
            self._act(why, ())
        else:
            self._act(why, _CHOICES[action])

    def _look_at_fence(self, now_ns: int) -> None:
        boundary, autopilot = self._fence, self._autopilot
        clearance_m = autopilot.fence_clearance_m()
        was = boundary.breach
        fresh = boundary.watch(clearance_m, now_ns)
        if not autopilot.armed:
            return
        action = int(self._parameters["FENCE_ACTION"])
        choices = _CHOICES[WITHOUT_SMART.get(action, action)]
        further_out = boundary.breach.outside and clearance_m < self._depth_m - _FURTHER_OUT_M
        if fresh or (further_out and choices):
            self._depth_m = clearance_m
            self._act("Fence breached", choices)
        elif was.outside and not boundary.breach.outside:
            autopilot.events.say(NOTICE, "Fence breach over")

    def _act(self, why: str, choices: tuple[int, ...]) -> None:
        """Take the first mode that can be had, and say which."""
        for number in choices:
            if self._autopilot.mode_problem(number) == "":
                self._autopilot.events.say(CRITICAL, f"{why}, {modes.NAMES[number]}")
                self._autopilot.switch(number)
                return
        self._autopilot.events.say(CRITICAL, why)


def fence_problems(boundary: Fence, clearance_m: float, position_valid: bool) -> tuple[str, ...]:
    """Why the fence does not let a vessel arm."""
    if not boundary.enabled:
        return ()
    if not position_valid:
        return ("Fence: needs a position",)
    return ("Fence: vessel is outside",) if clearance_m < 0.0 else ()


class FailsafeCondition:
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


class FailsafeMonitor:
    """The watches. Each method takes one look and says whether its watch has just changed."""

    def __init__(self, parameters: Parameters) -> None:
        self.imu = FailsafeCondition()
        self.ekf = FailsafeCondition()
        self.gcs = FailsafeCondition()
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
