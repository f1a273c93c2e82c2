"""Whether two logs that their clocks lay over each other saw the same vessel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Pairing, match
from xitl_cli.logs.compare.lag import best_lag
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals import Series

_WITHIN_S = 1.0
_FEWEST = 50
_LEAST_ALIKE = 0.8
_SIGNALS: tuple[tuple[str, Callable[[Log], Series | None], float], ...] = (
    ("roll", signals.roll, 0.5),
    ("pitch", signals.pitch, 0.5),
    ("speed over ground", signals.ground_speed, 0.2),
    ("yaw", signals.yaw, 2.0),
)
"""With the scatter from which on it is motion. Waves and gusts, which differ from run to run, come first."""


def contradiction(a: Log, b: Log, pairing: Pairing) -> str | None:
    """The end of a sentence, where a signal of both that moves is not the same one; else None."""
    for name, of, moving in _SIGNALS:
        in_a = of(a)
        in_b = None if in_a is None else of(b)
        matched = None if in_a is None or in_b is None else match(in_a, in_b, pairing)
        if matched is None or in_a is None or len(matched[0]) < _FEWEST:
            continue
        stamps, first, second = matched
        if min(_scatter(first, in_a.turns), _scatter(second, in_a.turns)) < moving:
            continue
        alike, _ = best_lag(stamps, first, second, turns=in_a.turns, longest_s=_WITHIN_S)
        if alike is not None and alike < _LEAST_ALIKE:
            return f"{name} of both correlates {alike:.2f} there"
    return None


def _scatter(values: np.ndarray, turns: bool) -> float:
    return float(np.std(np.unwrap(values, period=360.0) if turns else values))
