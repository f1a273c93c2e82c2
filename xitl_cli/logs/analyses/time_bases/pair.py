"""A pair of clocks in names and figures."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.timeline.clock_fit import Relation
from xitl_cli.logs.timeline.readings import Readings
from xitl_cli.logs.timeline.steps import Step

RTC_STEP_S = 0.05  # a message of UTC that came with less delay than any before moves it ahead, which is no news


def title_of(readings: Readings) -> str:
    return f"{readings.second} against {readings.first}"


def key_of(readings: Readings) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in readings.key).strip("_").lower()


def rate_of(relation: Relation) -> tuple[float, float | None]:
    """Over the pieces that have readings enough to know it; the standard error of the longest.

    Each is weighed by the cube of its length, as the variance of a slope falls with that.
    """
    pieces = [piece for piece in relation.pieces if piece.slope_error_ppm is not None] or [relation.longest]
    weights = np.array([max((piece.until_ns - piece.from_ns) * 1e-9, 1e-9) ** 3 for piece in pieces])
    rates = np.array([piece.slope_ppm for piece in pieces])
    return float(np.sum(rates * weights) / np.sum(weights)), max(
        pieces, key=lambda piece: piece.until_ns - piece.from_ns
    ).slope_error_ppm


def variation_of(relation: Relation) -> float | None:
    return float(np.std(relation.window_ppm, ddof=1)) if len(relation.window_ppm) > 1 else None


def real_steps(relation: Relation) -> list[Step]:
    least_s = RTC_STEP_S if relation.readings.key == "rtc" else 0.0
    return [step for step in relation.steps if abs(step.size_s) > least_s]
