"""Standard errors of least squares whose residuals are correlated within a window and with those of the next one.

    V = B (sum_ij k_ij s_i s_j^T + P) B,   B = (J^T J + P)^-1,   s_i = J_i^T (I - J_i B J_i^T)^(-1/2) e_i

e_i and J_i are residuals and derivatives of window i, and P is the precision of the priors. Sums over windows are those
of Liang and Zeger (1986). The root makes them unbiased for white residuals (CR2; Bell and McCaffrey 2002). k is
Bartlett's kernel (Newey and West 1987): 1 for a window with itself, and a half for adjacent ones.

Such a sum over few windows is uncertain itself. The standard error of a'x is therefore widened by the quantile of
Student's t, so that two standard errors contain the truth in 95.4 % of cases. The degrees of freedom are those of
Satterthwaite for white residuals (Bell and McCaffrey 2002; Imbens and Kolesar 2016).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student  # type: ignore[import-untyped]

from sim_core.dataclass import dataclass
from xitl_cli.plugins.identify.recording import Floats

_TWO_SIGMA = 0.97725
"""Share of a normal distribution below two standard deviations."""
_LEAST = 1e-9
"""Least eigenvalue of I - leverage: a window that alone determines a parameter has 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Sandwich:
    """Sums over W windows from which the standard error of any linear combination of P parameters follows.

    R is the root of B, and M_i = R J_i^T J_i R the leverage of a window.
    """

    bread: Floats
    """(P, P) B."""
    root: Floats
    """(P, P) R."""
    precision: Floats
    """(P,) diagonal of P, the priors' precision."""
    scores: Floats
    """(W, P) s_i."""
    half: Floats
    """(W, P, P) M_i (I - M_i)^(-1/2)."""
    whole: Floats
    """(W, P, P) M_i (I - M_i)^-1."""
    kernel: Floats
    """(W, W) k."""

    @classmethod
    def from_windows(
        cls, residual: Floats, jacobian: Floats, rows: Sequence[slice], adjacent: Floats, prior: Floats
    ) -> Sandwich:
        """Compute the sums.

        residual: (M,) and jacobian: (M, P), weighted to a standard deviation of 1. rows: of each of the W windows.
        adjacent: (W, W) 1 for windows of which one follows the other. prior: (P,) standard deviations, may be infinite.
        """
        precision, count = prior**-2.0, len(prior)
        information = np.stack([jacobian[own].T @ jacobian[own] for own in rows])
        values, vectors = np.linalg.eigh(np.linalg.inv(information.sum(axis=0) + np.diag(precision)))
        root, unroot = (vectors * values**0.5) @ vectors.T, (vectors * values**-0.5) @ vectors.T
        values, vectors = np.linalg.eigh(np.eye(count) - root @ information @ root)
        values = np.maximum(values, _LEAST)[:, None, :]
        rest, turned = 1.0 - values, vectors.transpose(0, 2, 1)
        inner = np.stack([jacobian[own].T @ residual[own] for own in rows])
        return cls(
            root @ root,
            root,
            precision,
            np.einsum("wij,wj->wi", unroot @ ((vectors * values**-0.5) @ turned) @ root, inner),
            (vectors * (rest * values**-0.5)) @ turned,
            (vectors * (rest / values)) @ turned,
            np.eye(len(rows)) + 0.5 * adjacent,
        )

    def covariance(self) -> Floats:
        """Return V, (P, P), without the widening for few windows."""
        meat = self.scores.T @ self.kernel @ self.scores + np.diag(self.precision)
        covariance: Floats = self.bread @ meat @ self.bread
        return covariance

    def sigma(self, slopes: Floats) -> Floats:
        """Return the standard errors of slopes @ x, (F,), for slopes (F, P)."""
        return np.array([self._sigma(own) for own in slopes])

    def _sigma(self, slope: Floats) -> float:
        at_root, at_bread = self.root @ slope, self.bread @ slope
        of_prior = float(at_bread**2 @ self.precision)
        white = float(slope @ at_bread) - of_prior
        # Products of the weights that each window's white residuals have, less what the fit takes from them
        half = self.half @ at_root
        kept = np.eye(len(slope)) + self.root @ np.diag(self.precision) @ self.root
        products = self.kernel @ (np.diag(self.whole @ at_root @ at_root) - half @ kept @ half.T)
        trace = float(np.trace(products))
        if trace < _LEAST * white or white <= 0.0:
            return math.sqrt(of_prior + max(white, 0.0))  # known by the prior, or by a single window
        degrees = max(trace**2 / float(np.sum(products * products.T)), 1.0)
        across = self.scores @ at_bread
        variance = float(across @ self.kernel @ across) * white / trace
        widened = 0.5 * float(student.ppf(_TWO_SIGMA, degrees))
        return math.sqrt(variance * widened**2 + of_prior)
