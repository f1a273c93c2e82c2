"""Definiteness check of mass and damping matrices in a profile, without numpy, like the keys."""

from __future__ import annotations

from collections.abc import Sequence

_ROUNDING = 1e-9


def lacking_diagonal(matrix: Sequence[Sequence[float]]) -> tuple[int, float] | None:
    """Return the first row with a diagonal entry too small for a definite symmetric part, and the required minimum.

    Return None if the symmetric part is positive semi-definite. The method is elimination. If the rows above are
    positive definite, the part remains so if and only if the remaining pivot is not negative.
    """
    size = len(matrix)
    rest = [[0.5 * (matrix[i][j] + matrix[j][i]) for j in range(size)] for i in range(size)]
    scale = [max(abs(entry) for entry in row) for row in rest]
    for k in range(size):
        pivot, below = rest[k][k], range(k + 1, size)
        tied = any(abs(rest[j][k]) > _ROUNDING * (scale[j] + scale[k]) for j in below)
        if pivot < -_ROUNDING * scale[k] or (pivot <= _ROUNDING * scale[k] and tied):
            return k, matrix[k][k] - pivot
        if tied:
            for i in below:
                share = rest[i][k] / pivot
                for j in below:
                    rest[i][j] -= share * rest[k][j]
    return None
