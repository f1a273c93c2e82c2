"""The simulation of N vessels, of which single vessels can restart.

The rows lie in blocks of `BLOCK` vessels, because a block fits into the caches of a processor. Every block has its own
random stream, so results do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from sim_core import simulation as simulations
from sim_core.dataclass import dataclass
from sim_core.environment.environment import Environment
from sim_core.frames import Array, matrix_to_euler
from sim_core.simulation import Simulation, SimulationState
from sim_core.world.contact import Outline
from xitl_cli.errors import UserError
from xitl_cli.plugins.learning.sensors import BlockSensors, check_sensors
from xitl_cli.plugins.learning.vessels import Vessels
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.world.world import build_simulation, has_waterway
from xitl_cli.seeds import Seeds

BLOCK = 512
SEA_M = 5000.0
"""Half the side of the square in which episodes start in different parts of the sea."""

DrawStarts = Callable[[Generator, int], tuple[Array, Array]]
"""Returns positions (K, 2), north and east in m, and headings (K,) in rad of K episodes."""
DrawGoals = Callable[[Generator, int], Array]
"""Returns the goals (K, G) of K episodes."""


@dataclass(slots=True)
class Block:
    """Some rows of a batch."""

    first: int
    """Number of its first row."""
    state: SimulationState
    rng: Generator
    sensors: BlockSensors
    touched: Array
    """1 for a vessel that touched something in the latest `advance`, else 0."""


class VesselBatch:
    """N vessels of one profile. Positions are in NED from the profile's origin.

    commands: number of actuators. steps: physics steps per call of `advance`.
    """

    def __init__(
        self,
        profile: RunProfile,
        count: int,
        control_rate_hz: float,
        starts: DrawStarts | None = None,
        goals: DrawGoals | None = None,
        sensors: Sequence[str] = (),
        threads: int = 1,
    ) -> None:
        """Raises UserError for a profile that a batch cannot simulate, and for an impossible control rate."""
        physics_hz = profile.clock.physics_rate_hz
        debris = profile.world.debris
        if control_rate_hz <= 0.0 or abs(physics_hz / control_rate_hz - round(physics_hz / control_rate_hz)) > 1e-9:
            raise UserError(
                f"{profile.name}: control_rate_hz = {control_rate_hz:g} must divide "
                f"clock.physics_rate_hz = {physics_hz:g}"
            )
        if profile.faults:
            raise UserError(f"{profile.name}: a learning environment has no faults; remove {', '.join(profile.faults)}")
        if debris.launches or debris.encounters.count or debris.control:
            raise UserError(f"{profile.name}: a learning environment has no debris; remove world.debris")
        check_sensors(profile, sensors)
        self.count = count
        self.commands = profile.vehicle.commands
        self.steps = round(profile.clock.physics_rate_hz / control_rate_hz)
        self._profile = profile
        self._simulation: Simulation = build_simulation(profile, Seeds(profile.clock.seed))[0]
        self._open_sea = not has_waterway(profile) and profile.environment.current.channel_width_m is None
        self._starts = starts or self._mission_start
        self._goals = goals or _no_goal
        self._sensors = tuple(sensors)
        self._pool = ThreadPoolExecutor(threads) if threads > 1 and count > BLOCK else None
        self._episodes = default_rng(0)
        self._blocks: list[Block] = []
        self._origin_ned_m = np.zeros((count, 3))
        self._start_ned_m = np.zeros((count, 3))
        self._began_ns = np.zeros(count, dtype=np.int64)
        self._goal = np.zeros((count, 0))

    @property
    def outline(self) -> Outline:
        """Outline of the hulls."""
        return self._simulation.outline

    def begin(self, seed: int) -> None:
        """Start all vessels in a new sea at time 0."""
        seeds = Seeds(seed)
        environment = Environment.from_spec(self._profile.environment, default_rng(seeds.sequence("waves")))
        self._simulation = self._simulation.in_environment(environment)
        self._episodes = default_rng(seeds.sequence("episodes"))
        self._began_ns = np.zeros(self.count, dtype=np.int64)
        places_ne_m, yaw_rad = self._drawn(np.arange(self.count))
        self._blocks = []
        for number, first in enumerate(range(0, self.count, BLOCK)):
            rows = slice(first, first + BLOCK)
            rng = default_rng(seeds.sequence(f"vessels {number}"))
            state = simulations.initial(self._simulation, places_ne_m[rows], yaw_rad[rows], rng)
            of_block = Seeds(seed, f"block {number}")
            dt_ns, air = self._simulation.dt_ns, environment.wind
            sensors = BlockSensors(self._profile, self._sensors, dt_ns, air, of_block)
            untouched = np.zeros(len(state.wind_ned_mps))
            block = Block(first, simulations.with_own_gusts(state), rng, sensors, untouched)
            sensors.begin(block.state, self._origin_ned_m[rows])
            self._blocks.append(block)
        self._start_ned_m = self._positions()

    def restart(self, rows: NDArray[np.intp]) -> None:
        """Start these vessels again, in increasing order, while all others stay as they are."""
        places_ne_m, yaw_rad = self._drawn(rows)
        for block in self._blocks:
            chosen = np.flatnonzero((rows >= block.first) & (rows < block.first + BLOCK))
            if len(chosen):
                own = rows[chosen] - block.first
                block.state = simulations.restarted(
                    self._simulation, block.state, own, places_ne_m[chosen], yaw_rad[chosen], block.rng
                )
                origin_ned_m = self._origin_ned_m[block.first : block.first + BLOCK]
                block.sensors.restart(own, block.state, origin_ned_m)
                block.touched = block.touched.copy()
                block.touched[own] = 0.0
        self._start_ned_m = self._start_ned_m.copy()
        self._start_ned_m[rows] = self._positions()[rows]
        self._began_ns[rows] = self._blocks[0].state.time_ns

    def advance(self, command: Array) -> None:
        """Advance by `steps` physics steps with (N, C) commands in [-1, 1]."""

        def run(block: Block) -> None:
            rows = slice(block.first, block.first + BLOCK)
            simulation, state, rng, sensors = self._simulation, block.state, block.rng, block.sensors
            own, origin_ned_m = command[rows], self._origin_ned_m[rows]
            block.touched = np.zeros(len(own))
            end_ns = state.time_ns + self.steps * simulation.dt_ns
            while state.time_ns < end_ns:
                left = 1 if self._sensors else (end_ns - state.time_ns) // simulation.dt_ns
                state = simulations.step(simulation, state, own, rng, left)
                sensors.advance(state, origin_ned_m)
                if len(state.contacts):
                    block.touched[state.contacts.vessel] = 1.0
            block.state = state

        if self._pool is None:
            for block in self._blocks:
                run(block)
        else:
            list(self._pool.map(run, self._blocks))

    def vessels(self) -> Vessels:
        """Return the vessels now."""
        states = [block.state for block in self._blocks]
        motions = [state.vessel.motion for state in states]
        rot_ned_frd = _joined([motion.rot_ned_frd for motion in motions])
        velocity = _joined([motion.vel_ned_mps for motion in motions])
        return Vessels(
            time_s=np.asarray((states[0].time_ns - self._began_ns) * 1e-9, dtype=np.float64),
            position_ned_m=self._positions(),
            start_ned_m=self._start_ned_m,
            velocity_ned_mps=velocity,
            velocity_frd_mps=(velocity[:, None, :] @ rot_ned_frd)[:, 0],
            euler_rad=matrix_to_euler(rot_ned_frd),
            rates_frd_radps=_joined([motion.gyro_frd_radps for motion in motions]),
            actuators=_joined([state.vessel.rotor_speed for state in states]),
            current_ned_mps=_joined([state.current_ned_mps for state in states]),
            wind_ned_mps=_joined([state.wind_ned_mps for state in states]),
            contact=_joined([block.touched for block in self._blocks]),
            goal=self._goal,
            sensors={
                name: _joined([block.sensors.by_name[name].latest for block in self._blocks]) for name in self._sensors
            },
        )

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _positions(self) -> Array:
        places = _joined([block.state.vessel.motion.pos_ned_m for block in self._blocks])
        return places - self._origin_ned_m

    def _drawn(self, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """Draw place, heading and goal of the next episodes of these rows, and the part of the sea.

        Returns places (K, 2) in the sea and headings (K,).
        """
        count = len(rows)
        places_ne_m, yaw_rad = self._starts(self._episodes, count)
        _check_shape("positions", np.asarray(places_ne_m), (count, 2))
        _check_shape("headings", np.asarray(yaw_rad), (count,))
        goal = np.asarray(self._goals(self._episodes, count), dtype=np.float64)
        if goal.ndim != 2 or len(goal) != count:
            raise ValueError(f"goal returned the shape {goal.shape} for {count} episodes; return ({count}, G)")
        self._goal = np.zeros((self.count, goal.shape[1])) if len(rows) == self.count else self._goal.copy()
        self._goal[rows] = goal
        if self._open_sea:
            self._origin_ned_m = self._origin_ned_m.copy()
            self._origin_ned_m[rows, :2] = self._episodes.uniform(-SEA_M, SEA_M, (count, 2))
        return np.asarray(places_ne_m) + self._origin_ned_m[rows, :2], np.asarray(yaw_rad, dtype=np.float64)

    def _mission_start(self, rng: Generator, count: int) -> tuple[Array, Array]:
        start = self._profile.mission.start
        return np.tile([start.north_m, start.east_m], (count, 1)), np.full(count, np.radians(start.heading_deg))


def _no_goal(rng: Generator, count: int) -> Array:
    return np.zeros((count, 0))


def _joined(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _check_shape(what: str, values: Array, wanted: tuple[int, ...]) -> None:
    if values.shape != wanted:
        raise ValueError(f"start returned {what} of the shape {values.shape}; return {wanted}")
