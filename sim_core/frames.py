"""Frames and attitudes. Only this module converts between them.

Conventions of the whole package: positions and velocities in NED (north, east, down), body axes FRD (forward, right,
down), quaternions `(w, x, y, z)` that turn body FRD into NED, Euler angles `(roll, pitch, yaw)` in the z-y-x order.
Every function takes and returns batches: `(..., 3)`, `(..., 4)` or `(..., 3, 3)`.
"""

from __future__ import annotations

import numpy as np
from numpy import complex128, float32, float64
from numpy.typing import NDArray

Array = NDArray[float64]
Array32 = NDArray[float32]
ComplexArray = NDArray[complex128]

_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FRD_FLU = np.diag([1.0, -1.0, -1.0])
# q_enu_ned = (0, 1, 1, 0) / sqrt(2) on the left, q_frd_flu = (0, 1, 0, 0) on the right, multiplied out:
# (w + z, x + y, x - y, w - z) / sqrt(2).
_QUAT_ENU_FLU = np.sqrt(0.5) * np.array(
    [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0], [0.0, 1.0, -1.0, 0.0], [1.0, 0.0, 0.0, -1.0]]
)


def _matrix_of_products() -> Array:
    """Constant (16, 9): `vec(R) = outer(q, q) @ constant` for a unit quaternion (Fossen 2021, eq 2.72)."""
    c = np.zeros((4, 4, 3, 3))
    w, x, y, z = range(4)
    for i, signs in enumerate(((1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1))):
        for component, sign in enumerate(signs):
            c[component, component, i, i] = sign
    for row, column, a, b, c_sign, d in ((0, 1, x, y, -1, z), (0, 2, x, z, 1, y), (1, 2, y, z, -1, x)):
        c[a, b, row, column] = c[a, b, column, row] = 2.0
        c[w, d, row, column] = 2.0 * c_sign
        c[w, d, column, row] = -2.0 * c_sign
    return c.reshape(16, 9)


_ROTATION = _matrix_of_products()


def ned_to_enu(v_ned: Array) -> Array:
    """(..., 3) NED -> ENU."""
    v_enu: Array = v_ned @ _NED_ENU
    return v_enu


def enu_to_ned(v_enu: Array) -> Array:
    """(..., 3) ENU -> NED."""
    v_ned: Array = v_enu @ _NED_ENU
    return v_ned


def frd_to_flu(v_frd: Array) -> Array:
    """(..., 3) body FRD -> FLU."""
    v_flu: Array = v_frd @ _FRD_FLU
    return v_flu


def flu_to_frd(v_flu: Array) -> Array:
    """(..., 3) body FLU -> FRD."""
    v_frd: Array = v_flu @ _FRD_FLU
    return v_frd


def quat_ned_frd_to_enu_flu(quat_ned_frd: Array) -> Array:
    """Convert a (..., 4) attitude FRD -> NED to FLU -> ENU, for tools that draw in ENU (REP 103)."""
    # Not as a matrix product, whose rounding may depend on the number of rows
    quat_enu_flu: Array = (quat_ned_frd[..., None] * _QUAT_ENU_FLU).sum(axis=-2)
    return quat_enu_flu


def quat_multiply(left: Array, right: Array) -> Array:
    """Hamilton product of (..., 4) quaternions: first `right` turns, then `left`."""
    w1, x1, y1, z1 = np.moveaxis(left, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(right, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def quat_conjugate(quat: Array) -> Array:
    """(..., 4) inverse of a unit quaternion."""
    conjugate: Array = quat * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def quat_normalize(quat: Array) -> Array:
    """Scale (..., 4) quaternions to unit length."""
    unit: Array = quat / np.sqrt(np.vecdot(quat, quat))[..., None]
    return unit


def quat_to_matrix(quat: Array) -> Array:
    """(..., 4) unit quaternion -> (..., 3, 3) rotation matrix, `v_ned = matrix @ v_frd`."""
    q = quat.reshape(-1, 4)
    products = (q[:, :, None] * q[:, None, :]).reshape(-1, 16)
    matrix: Array = products.dot(_ROTATION).reshape((*quat.shape[:-1], 3, 3))
    return matrix


def matrix_to_quat(matrix: Array) -> Array:
    """(..., 3, 3) rotation matrix -> (..., 4) unit quaternion with w >= 0 (Shepperd's choice of the largest term)."""
    m = matrix.reshape(-1, 3, 3)
    diagonal = m[:, (0, 1, 2), (0, 1, 2)]
    trace = diagonal.sum(axis=1)
    # 4 q_i q_j for all i, j. The row with the largest diagonal is q times a number that is not small.
    k = np.empty((len(m), 4, 4))
    k[:, 0, 0] = 1.0 + trace
    k[:, (1, 2, 3), (1, 2, 3)] = 1.0 - trace[:, None] + 2.0 * diagonal
    for i, (a, b) in enumerate(((2, 1), (0, 2), (1, 0)), start=1):
        k[:, 0, i] = k[:, i, 0] = m[:, a, b] - m[:, b, a]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        k[:, a + 1, b + 1] = k[:, b + 1, a + 1] = m[:, a, b] + m[:, b, a]
    best = np.argmax(k[:, (0, 1, 2, 3), (0, 1, 2, 3)], axis=1)
    quat = quat_normalize(k[np.arange(len(m)), best])
    return (quat * np.where(quat[:, :1] < 0.0, -1.0, 1.0)).reshape(*matrix.shape[:-2], 4)


def euler_to_quat(euler_rad: Array) -> Array:
    """(..., 3) roll, pitch, yaw -> (..., 4) quaternion."""
    half = 0.5 * np.asarray(euler_rad, dtype=np.float64)
    cr, cp, cy = np.moveaxis(np.cos(half), -1, 0)
    sr, sp, sy = np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def matrix_to_euler(matrix: Array) -> Array:
    """(..., 3, 3) rotation matrix -> (..., 3) roll, pitch in [-pi/2, pi/2], yaw."""
    roll = np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2])
    pitch = -np.arcsin(np.clip(matrix[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def quat_to_euler(quat: Array) -> Array:
    """(..., 4) quaternion -> (..., 3) roll, pitch, yaw."""
    return matrix_to_euler(quat_to_matrix(quat))


def wrap_pi(angle_rad: Array) -> Array:
    """Any angle -> the same angle in [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi
