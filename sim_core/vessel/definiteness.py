"""Whether a matrix of a profile is one of a mass or of a damping: without numpy, as the keys are."""

from __future__ import annotations

from collections.abc import Sequence

_ROUNDING = 1e-9


def lacking_diagonal(matrix: Sequence[Sequence[float]]) -> tuple[int, float] | None:
    """The first row whose diagonal entry lets the symmetric part be indefinite, and what it has to reach.

    None for a matrix whose symmetric part is positive semi-definite. By elimination: with the rows above positive
    definite, that part is so too if and only if the pivot that is left of the diagonal entry is not negative.
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
