"""Effects of a bottom close to the keel: added mass, sway and yaw damping, resistance, and sinkage under way (squat).

T is the draft of the lowest line, h the depth of the still water, nabla the displacement, F_h = u / sqrt(g h).

    added mass of sway and yaw    8 / pi^2 (h / T)^2 ln sec(pi T / 2 h)
    sway and yaw damping          1 / (T / 2 h + (pi T / 2 h cot(pi T / 2 h))^q), at least 1
                                  q: Y_v 2.3, N_v 1.7, Y_r and N_r 0.7
    N_vvr and N_vrr of a table    1 + 6 (T / h)^2.5
    viscous resistance            1 + 0.57 (T / h)^1.79
    sinkage                       1.46 nabla / L^2 (S(u^2 / (g h)) - S(u^2 / (0.3 g L))), S(x) = x / sqrt(1 - x)
    resistance of the sinkage     (1 + sinkage * waterplane / nabla)^(2/3), with a share of at most 5 %

The first is the potential flow past a row of plates (Lamb 1932, Newman 1969), the limit of a narrow section. The second
is the effective aspect ratio of Hirano, Takashina, Moriya and Nakamura (1985); quadratic sway and yaw have its factor
of Y_v. The third is that of Tang et al. (2020), as mmgdynamics quotes it. The others are those of Raven (2016).
docs/vessel.md has their range.
"""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.frames import Array
from sim_core.vessel.floating import FloatingPose
from sim_core.vessel.spec import VesselSpec

DEEP = 10.0
"""h / T from which draft has no effect."""
SHALLOWEST = 1.2
"""h / T below which factors keep their value: the formulas have no data there."""
DEEP_OF_LENGTH = 0.3
"""h / L from which there is no sinkage in the formula."""
LARGEST_FROUDE_NUMBER = 0.7
"""F_h above which sinkage keeps its value: the formula has a pole at 1, the critical speed."""
_Y, _N, _U, _V, _P, _R = 1, 5, 0, 1, 3, 5


@dataclass(frozen=True, slots=True, eq=False)
class ConfinedWater:
    """Factors of one vessel in water of one depth."""

    added_mass: float
    """Factor of the added mass of sway and yaw."""
    damping: Array
    """Factors of the linear damping, (6, 6): component, velocity."""
    turn_in_drift: float
    """Factor of the yaw moments of turn and drift together, N_vvr and N_vrr."""
    resistance: float
    """Factor of the viscous resistance."""
    sinks: bool
    """Whether the vessel sinks under way."""
    depth_m: float
    rest: FloatingPose
    length_m: float

    @property
    def congruent(self) -> Array:
        """Return the (6,) s with which s_i A_ij s_j is the added mass. It stays symmetric and definite."""
        share = np.ones(6)
        share[[_V, _R]] = math.sqrt(self.added_mass)
        return share


def felt_depth_m(model: VesselSpec, rest: FloatingPose, depth_m: float) -> float:
    """Return the depth for `confined_water`: infinite where it has no effect, not below the range of the factors."""
    if not model.confined_water or depth_m >= max(DEEP * rest.draft_m, DEEP_OF_LENGTH * model.length_m):
        return math.inf
    return max(depth_m, SHALLOWEST * rest.draft_m)


def confined_water(model: VesselSpec, depth_m: float, rest: FloatingPose) -> ConfinedWater | None:
    """Return the effects of the bottom; None in deep water, or for a vessel without `confined_water`."""
    ratio = depth_m / rest.draft_m
    sinks = depth_m < DEEP_OF_LENGTH * model.length_m
    if not model.confined_water or (ratio >= DEEP and not sinks):
        return None
    damping = np.ones((6, 6))
    if ratio >= DEEP:
        return ConfinedWater(1.0, damping, 1.0, 1.0, sinks, depth_m, rest, model.length_m)
    damping[[_Y, _Y, _P], [_V, _P, _V]] = aspect_factor(ratio, 2.3)
    damping[_N, [_V, _P]] = aspect_factor(ratio, 1.7)
    damping[[_Y, _P, _N], _R] = aspect_factor(ratio, 0.7)
    damping[_U, _U] = resistance_factor(ratio)
    mass, turn_in_drift = added_mass_factor(ratio), turn_in_drift_factor(ratio)
    return ConfinedWater(mass, damping, turn_in_drift, float(damping[_U, _U]), sinks, depth_m, rest, model.length_m)


def added_mass_factor(ratio: float) -> float:
    """Return the factor of the added mass of sway and yaw at h / T."""
    ratio = max(ratio, SHALLOWEST)
    return -8.0 / math.pi**2 * ratio * ratio * math.log(math.cos(0.5 * math.pi / ratio))


def aspect_factor(ratio: float, exponent: float) -> float:
    """Return the factor of a linear derivative of sway or yaw at h / T, at least 1."""
    ratio = max(ratio, SHALLOWEST)
    quarter = 0.5 * math.pi / ratio
    return max(1.0 / (0.5 / ratio + math.pow(quarter / math.tan(quarter), exponent)), 1.0)


def turn_in_drift_factor(ratio: float) -> float:
    """Return the factor of the yaw moments of turn and drift together at h / T."""
    return 1.0 + 6.0 * math.pow(max(ratio, SHALLOWEST), -2.5)


def resistance_factor(ratio: float) -> float:
    """Return the factor of the viscous resistance at h / T."""
    return 1.0 + 0.57 * math.pow(max(ratio, SHALLOWEST), -1.79)


@dataclass(frozen=True, slots=True, eq=False)
class Squat:
    """Sinkage under way, as the force that presses the vessel down by it, and the resistance that it adds."""

    per_square: tuple[float, float]
    """1 / (g h) and 1 / (0.3 g L)."""
    largest_square: float
    """u^2 above which the sinkage keeps its value."""
    sinkage_m: float
    """1.46 nabla / L^2."""
    share_per_m: float
    """Waterplane over displacement."""
    wrench: Array
    """(3, 6): per metre, per u |u| and per u."""

    @classmethod
    def from_parts(cls, confined: ConfinedWater, linear: Array, quadratic: Array) -> Squat:
        """Compute the constants. linear, quadratic: (6,) force and moment of the resistance per u and per u |u|."""
        rest, length_m = confined.rest, confined.length_m
        down = np.zeros(6)
        down[2:5] = rest.stiffness[:, 0]
        return cls(
            (1.0 / (GRAVITY_MPS2 * confined.depth_m), 1.0 / (GRAVITY_MPS2 * DEEP_OF_LENGTH * length_m)),
            LARGEST_FROUDE_NUMBER**2 * GRAVITY_MPS2 * confined.depth_m,
            1.46 * rest.displacement_m3 / length_m**2,
            rest.waterplane_area_m2 / rest.displacement_m3,
            np.stack([down, quadratic, linear]),
        )

    def terms(self, nu_r: Array) -> tuple[Array]:
        """Return (N, 3)."""
        u = nu_r[:, :1]
        square = np.minimum(u * u, self.largest_square)
        here, deep = (_rise(square * share) for share in self.per_square)
        sinkage_m = self.sinkage_m * (here - deep)
        share = np.minimum(self.share_per_m * sinkage_m, 0.05)
        more = np.expm1(np.log(1.0 + share) * (2.0 / 3.0)) * u
        return (np.concatenate((sinkage_m, more * np.abs(u), more), axis=1),)


def _rise(square: Array) -> Array:
    rise: Array = square / np.sqrt(1.0 - square)
    return rise
