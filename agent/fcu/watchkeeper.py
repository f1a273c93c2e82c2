"""The watchkeeper: looks at failsafes and fence every cycle, acts, and says so; says too when it is over."""

from __future__ import annotations

from typing import TYPE_CHECKING

from agent.fcu import failsafe, modes
from agent.fcu.events import CRITICAL, NOTICE, WARNING
from agent.fcu.failsafe import Failsafes
from agent.fcu.fence import Fence
from agent.fcu.parameters import Parameters

if TYPE_CHECKING:
    from agent.fcu.autopilot import Autopilot

_FENCE_EVERY = 10  # cycles
_FURTHER_OUT_M = 20.0  # so much more, and the fence acts again
_CONTINUE_IN_AUTO = 2  # FS_GCS_ENABLE
_HOLD, _REPORT = 1, 2  # FS_EKF_ACTION


class Watchkeeper:
    """Acts on an autopilot. A mode that was changed stays changed when the cause is over."""

    def __init__(self, autopilot: Autopilot, parameters: Parameters, boundary: Fence, failsafes: Failsafes) -> None:
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
        action = failsafe.WITHOUT_SMART.get(action, action)
        if action == failsafe.DISARM:
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
        choices = _CHOICES[failsafe.WITHOUT_SMART.get(action, action)]
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


_CHOICES = {
    failsafe.NONE: (),
    failsafe.RTL_OR_HOLD: (modes.RTL, modes.HOLD),
    failsafe.HOLD: (modes.HOLD,),
    failsafe.LOITER_OR_HOLD: (modes.LOITER, modes.HOLD),
}


def fence_problems(boundary: Fence, clearance_m: float, position_valid: bool) -> tuple[str, ...]:
    """Why the fence does not let a vessel arm."""
    if not boundary.enabled:
        return ()
    if not position_valid:
        return ("Fence: needs a position",)
    return ("Fence: vessel is outside",) if clearance_m < 0.0 else ()
