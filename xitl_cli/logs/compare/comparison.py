"""Two logs compared: what `xitl logs compare` shows, writes and draws."""

from __future__ import annotations

from dataclasses import dataclass, replace

from xitl_cli.logs import signals
from xitl_cli.logs.compare.channels import channel_section
from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.compare.motion import motion_section
from xitl_cli.logs.compare.overlay import overlay
from xitl_cli.logs.compare.pairing import Start, pair, within, zero_ns
from xitl_cli.logs.compare.position import poses
from xitl_cli.logs.compare.states import event_section, modes
from xitl_cli.logs.compare.trajectories import Alignment, Trajectory
from xitl_cli.logs.compare.trajectory_section import moved_poses, trajectory_section
from xitl_cli.logs.compare.truth import stray_truth
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Section
from xitl_cli.logs.signals import Of, Span

_OVERLAID = ("scheduler", "time_bases")


@dataclass(frozen=True, slots=True)
class Comparison:
    """zero_ns: on A's time, what seconds count from: where both were laid over each other, else the common begin.

    zero_s: the same since A's first row. trajectories: A's and B's poses at common stamps, B moved as asked; None where
    positions are missing. states: armed and modes of A, on its time.
    """

    sections: tuple[Section, ...]
    pairing: Pairing
    zero_ns: int
    zero_s: float
    trajectories: tuple[Trajectory, Trajectory] | None
    states: tuple[Span, ...]

    @property
    def zero_sentence(self) -> str:
        return f"0 s is {self.zero_s:.3f} s after A's first row"


def compare(
    a: Log,
    b: Log,
    *,
    align: Alignment = "none",
    start: Start = "auto",
    shift_s: float | None = None,
    of_a: Of = "estimate",
    of_b: Of = "estimate",
    from_s: float | None = None,
    until_s: float | None = None,
    armed: bool = False,
) -> Comparison:
    """B against A. from_s, until_s: after the zero; armed: only while both were.

    Events, scheduler and time bases are those of the whole logs. Raises LogError when there is no way to lay one on
    the time of the other, or nothing is left of it.
    """
    laid = pair(a, b, start, shift_s)
    pairing = within(a, b, laid, from_s, until_s, armed)
    both = poses(a, b, pairing, of_a, of_b)
    zero = zero_ns(a, b, pairing)
    sections = [
        _doubted(
            _without_positions(a, b, of_a, of_b) if both is None else trajectory_section(both, align),
            (("A", a, of_a), ("B", b, of_b)),
        ),
        motion_section(a, b, pairing, of_a, of_b),
        channel_section(a, b, pairing),
        event_section(a, b, pairing, zero),
        *(overlay(name, a, b, pairing) for name in _OVERLAID),
    ]
    return Comparison(
        tuple(section for section in sections if section is not None),
        pairing,
        zero,
        0.0 if a.span_ns is None else (zero - a.span_ns[0]) * 1e-9,
        None if both is None else (both.a, moved_poses(both, align)[0]),
        (*signals.armed(a), *modes(a)),
    )


def _doubted(section: Section, sides: tuple[tuple[str, Log, Of], ...]) -> Section:
    """With the doubts about what was taken for the truth."""
    doubts = (stray_truth(name, log) for name, log, of in sides if of == "truth")
    return replace(section, findings=(*section.findings, *(doubt for doubt in doubts if doubt is not None)))


def _without_positions(a: Log, b: Log, of_a: Of, of_b: Of) -> Section:
    without = [name for name, log, of in (("A", a, of_a), ("B", b, of_b)) if signals.position_ned(log, of) is None]
    why = (
        f"{' and '.join(without)} {'hold' if len(without) > 1 else 'holds'} no position"
        if without
        else "their positions have no common time"
    )
    return Section("trajectory", "Trajectory", lacks=(f"The paths are not compared: {why}.",))
