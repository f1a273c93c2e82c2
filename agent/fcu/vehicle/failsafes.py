"""Failsafes: IMU, estimate, ground station and fence are checked every cycle, and each has an action."""

from __future__ import annotations

import math
from typing import Callable

from agent.fcu.control.manual_control import ManualControl
from agent.fcu.fence import Fence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.navigation import Navigator
from agent.fcu.vehicle_state import CRITICAL, NOTICE, WARNING, EventQueue, VehicleState
from agent.navigation.estimator import Estimator
from agent.navigation.measurements import ArmingProblem
from agent.navigation.position_filter import InnovationRatios

_FENCE_EVERY = 10  # cycles
_FURTHER_OUT_M = 20.0  # the fence acts again this much farther out
_CONTINUE_IN_AUTO = 2  # FS_GCS_ENABLE
_EKF_HOLD, _EKF_REPORT = 1, 2  # FS_EKF_ACTION
_DISARM = 5  # FS_ACTION
_MODES_OF_ACTION = {  # FS_ACTION and FENCE_ACTION: modes to try in turn
    0: (),
    1: (modes.RTL, modes.HOLD),
    2: (modes.HOLD,),
    3: (modes.SMART_RTL, modes.RTL, modes.HOLD),
    4: (modes.SMART_RTL, modes.HOLD),
    6: (modes.LOITER, modes.HOLD),
}
_EKF_BAD_NS = 1_000_000_000
_FIRST_FIX_NS = 3_000_000_000  # after a silence of all sensors, the first fix arrives later than the first IMU sample


class FailsafeCondition:
    """A condition that becomes `active` after it has lasted."""

    def __init__(self) -> None:
        self.active = False
        self._since_ns: int | None = None

    def update(self, bad: bool, now_ns: int, after_ns: int) -> bool:
        """Update the condition. Return True when `active` has just changed."""
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
    """Conditions of IMU, estimate (EKF) and ground station (GCS).

    Each `update_...` returns whether its condition changed.
    """

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
        """Apply changed parameters."""
        p = self._parameters
        self.imu_timeout_s = p["FS_IMU_TIMEOUT"]
        self.gcs_timeout_s = p["FS_GCS_TIMEOUT"]
        self._lasting_ns = int(p["FS_TIMEOUT"] * 1e9)
        self._gcs_enabled = p["FS_GCS_ENABLE"] >= 1.0
        self._gcs_system = int(p["SYSID_MYGCS"])
        self._ekf_threshold = p["FS_EKF_THRESH"]

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active failsafes."""
        named = (("IMU", self.imu), ("EKF", self.ekf), ("GCS", self.gcs))
        return tuple(name for name, condition in named if condition.active)

    def heard_ground_station(self, system_id: int, now_ns: int) -> None:
        """Note a heartbeat, if it is from SYSID_MYGCS."""
        if self._gcs_system in (0, system_id):
            self._gcs_heard_ns = now_ns

    def update_imu(self, accepted: int, armed: bool, now_ns: int) -> bool:
        """Update the IMU condition.

        accepted: number of samples.

        Silence counts after the first sample, or when armed.
        """
        if accepted != self._imu_accepted or self._imu_seen_ns is None:
            self._imu_accepted = accepted
            self._imu_seen_ns = now_ns
        silent = now_ns - self._imu_seen_ns > self.imu_timeout_s * 1e9 and (accepted > 0 or armed)
        changed = self.imu.update(silent, now_ns, 0)
        if changed:
            self._imu_back_ns = None if silent else now_ns
        return changed

    def update_ekf(self, lost: bool, ratios: InnovationRatios, steering_by_it: bool, now_ns: int) -> bool:
        """Update the EKF condition: bad at once without a position, or after a second of test ratios over ArduPilot's
        limit.

        It does not change while the IMU is silent, because outputs are then neutral, nor just after. Steering then
        continues with the first fix.
        """
        if not steering_by_it and not self.ekf.active:
            return False
        back_ns = self._imu_back_ns
        if self.imu.active or (back_ns is not None and 0 <= now_ns - back_ns < _FIRST_FIX_NS):
            return False
        after_ns = 0 if lost else _EKF_BAD_NS
        return self.ekf.update(lost or self._is_over(ratios), now_ns, after_ns)

    def update_gcs(self, armed: bool, now_ns: int) -> bool:
        """Update the GCS condition: silence of a station that was heard before, for FS_GCS_TIMEOUT plus FS_TIMEOUT."""
        heard_ns = self._gcs_heard_ns
        silent = (
            self._gcs_enabled
            and heard_ns is not None
            and (armed or self.gcs.active)
            and now_ns - heard_ns >= self.gcs_timeout_s * 1e9
        )
        return self.gcs.update(silent, now_ns, self._lasting_ns)

    def _is_over(self, ratios: InnovationRatios) -> bool:
        """ArduPilot's ekf_over_threshold: position and one more, or two of velocity (counted twice when far over) and
        compass.
        """
        limit = self._ekf_threshold
        if limit <= 0.0:
            return False
        velocity, heading = math.sqrt(ratios.velocity), math.sqrt(ratios.heading)
        over = (heading >= limit) + (velocity >= limit) + (velocity >= 2.0 * limit)
        return over >= 2 or (over >= 1 and ratios.position >= limit * limit)


class FailsafeHandler:
    """Updates the conditions, switches modes or disarms, and adds events at their start and end.

    A mode switched by a failsafe remains when the cause ends.
    """

    def __init__(
        self,
        parameters: Parameters,
        state: VehicleState,
        estimator: Estimator,
        navigator: Navigator,
        fence: Fence,
        manual: ManualControl,
        events: EventQueue,
        mode_problem: Callable[[int], str],
        switch_mode: Callable[[int], None],
        disarm: Callable[[], None],
    ) -> None:
        self._monitor = FailsafeMonitor(parameters)
        self._parameters = parameters
        self._state = state
        self._estimator = estimator
        self._navigator = navigator
        self._fence = fence
        self._manual = manual
        self._events = events
        self._mode_problem = mode_problem
        self._switch_mode = switch_mode
        self._disarm = disarm
        self._fence_cycle = 0
        self._fence_depth_m = 0.0

    def configure(self) -> None:
        """Apply changed parameters."""
        self._monitor.configure()

    def heard_ground_station(self, system_id: int, now_ns: int) -> None:
        """Note a heartbeat or input of a ground station."""
        self._monitor.heard_ground_station(system_id, now_ns)

    @property
    def imu_lost(self) -> bool:
        """Whether outputs are neutral because the IMU is silent."""
        return self._monitor.imu.active

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active failsafes: IMU, EKF, GCS, Fence."""
        return (*self._monitor.active, *(("Fence",) if self._fence.breach.outside else ()))

    def update(self, now_ns: int) -> None:
        """Run one cycle."""
        state, monitor = self._state, self._monitor
        if monitor.update_imu(self._estimator.imu_accepted, state.armed, now_ns):
            if monitor.imu.active:
                self._events.add(CRITICAL, f"Failsafe: no IMU for {monitor.imu_timeout_s:g} s, outputs neutral")
            else:
                self._events.add(NOTICE, "Failsafe over: IMU is back, outputs resume")
        position_valid = state.estimate.position_valid
        steering_by_it = state.armed and modes.BY_NUMBER[state.mode].needs_position
        if monitor.update_ekf(not position_valid, self._estimator.ratios, steering_by_it, now_ns):
            self._on_ekf(position_valid)
        if monitor.update_gcs(state.armed, now_ns):
            self._on_gcs()
        if self._fence_cycle == 0 and position_valid:
            self._update_fence(now_ns)
        self._fence_cycle = (self._fence_cycle + 1) % _FENCE_EVERY

    def _on_ekf(self, position_valid: bool) -> None:
        action = int(self._parameters["FS_EKF_ACTION"])
        if action not in (_EKF_HOLD, _EKF_REPORT):
            return
        if not self._monitor.ekf.active:
            self._events.add(NOTICE, "EKF failsafe over")
            return
        why = "EKF failsafe: estimate inconsistent" if position_valid else "EKF failsafe: position lost"
        self._act(why, (modes.HOLD,) if action == _EKF_HOLD else ())

    def _on_gcs(self) -> None:
        if not self._monitor.gcs.active:
            self._events.add(NOTICE, "GCS failsafe over: ground station is back")
            return
        why = f"GCS failsafe: no heartbeat for {self._monitor.gcs_timeout_s:g} s"
        self._manual.release()
        mode = self._state.mode
        if mode == modes.AUTO and int(self._parameters["FS_GCS_ENABLE"]) == _CONTINUE_IN_AUTO:
            self._events.add(WARNING, f"{why}, continuing in AUTO")
            return
        action = int(self._parameters["FS_ACTION"])
        if action == _DISARM:
            self._events.add(CRITICAL, f"{why}, disarming")
            self._disarm()
        elif mode in (modes.HOLD, modes.RTL, modes.SMART_RTL):
            self._act(why, ())
        else:
            self._act(why, _MODES_OF_ACTION[action])

    def _act(self, why: str, choices: tuple[int, ...]) -> None:
        """Switch to the first available mode of `choices`, and name it in the event."""
        for number in choices:
            if self._mode_problem(number) == "":
                self._events.add(CRITICAL, f"{why}, {modes.NAMES[number]}")
                self._switch_mode(number)
                return
        self._events.add(CRITICAL, why)

    # -- the fence

    def fence_problems(self) -> tuple[ArmingProblem, ...]:
        """Return the reasons why the fence prevents arming."""
        if not self._fence.enabled:
            return ()
        if not self._state.estimate.position_valid:
            return (ArmingProblem("Fence", "Fence requires position"),)
        if self._fence_clearance_m() >= 0.0:
            return ()
        return (ArmingProblem("Fence", f"Vehicle breaching {self._fence.names}"),)

    def restart_fence(self) -> None:
        """Restart the fence at arming: a vessel outside the fence is a new breach."""
        self._fence.forget_breach()
        self._fence_cycle = 0

    def _fence_clearance_m(self) -> float:
        """Clearance inside the fence, negative outside, infinite without fence or position."""
        frame = self._estimator.frame
        if frame is None or not self._fence.enabled:
            return math.inf
        north_m, east_m, _ = self._state.estimate.pos_ned_m
        return self._fence.clearance_m(frame, self._navigator.home, *frame.to_geodetic(north_m, east_m))

    def _update_fence(self, now_ns: int) -> None:
        fence = self._fence
        clearance_m = self._fence_clearance_m()
        was = fence.breach
        fresh = fence.update_breach(clearance_m, now_ns)
        if not self._state.armed:
            return
        choices = _MODES_OF_ACTION[int(self._parameters["FENCE_ACTION"])]
        further_out = fence.breach.outside and clearance_m < self._fence_depth_m - _FURTHER_OUT_M
        if fresh or (further_out and choices):
            self._fence_depth_m = clearance_m
            self._act("Fence breached", choices)
        elif was.outside and not fence.breach.outside:
            self._events.add(NOTICE, "Fence breach over")
