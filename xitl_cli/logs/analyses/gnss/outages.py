"""When a receiver had no fix, or said nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.gaps import regularity
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Severity
from xitl_cli.logs.sensing.columns import some
from xitl_cli.logs.sensing.fixes import FIX_3D, FIX_NAMES, Receiver
from xitl_cli.logs.sensing.pauses import covered, ends_ns
from xitl_cli.logs.sensing.settings import armed_rows

_RTK = 5
_SILENT_S = 1.0


def fixed_rows(receiver: Receiver) -> NDArray[np.bool_]:
    good: NDArray[np.bool_] = receiver.fix >= FIX_3D
    return good


def fixes(log: Log, receiver: Receiver, pause: NDArray[np.int64], instants: Instants) -> list[Finding]:
    """Fixes lost after the first one, and a first one that never came."""
    fixed = fixed_rows(receiver)
    field = receiver.fields["fix"]
    if not fixed.any():
        best = FIX_NAMES.get(int(receiver.fix.max()), f"status {int(receiver.fix.max())}")
        return [
            Finding(
                "gnss.no_fix",
                Severity.WARNING,
                f"{receiver.name} never had a 3D fix; the best was: {best}",
                (Evidence(receiver.message, field, int(receiver.stamp_ns[0]), int(receiver.stamp_ns[-1])),),
                "Check antenna and sky; a receiver that is not fitted should be disabled.",
            )
        ]
    findings = _outages(log, receiver, fixed, pause, instants)
    fell = np.flatnonzero((receiver.fix[:-1] >= _RTK) & (receiver.fix[1:] < receiver.fix[:-1]) & fixed[1:])
    if len(fell):
        times = some([instants.text(int(receiver.stamp_ns[row + 1])) for row in fell])
        findings.append(
            Finding(
                "gnss.rtk_lost",
                Severity.NOTICE,
                f"{receiver.name} fell from an RTK solution to a lesser one {_times(len(fell))}: at {times}",
                tuple(Evidence(receiver.message, field, int(receiver.stamp_ns[row + 1])) for row in fell[:8]),
                "Look at the link that carries the corrections, and at the satellites then.",
            )
        )
    return findings


def _outages(
    log: Log, receiver: Receiver, fixed: NDArray[np.bool_], pause: NDArray[np.int64], instants: Instants
) -> list[Finding]:
    """Times between two fixes with messages that say there is none, or with no message at all for over a second and
    five periods. One at the end of the log counts to its end.
    """
    good = np.flatnonzero(fixed)
    regular = regularity(receiver.sample_ns[good])
    if regular is None:
        return []
    reached = np.maximum.accumulate(receiver.sample_ns[good])
    length_ns = np.diff(reached)
    between = np.diff(good) - 1
    from_ns = receiver.stamp_ns[good[:-1]]
    whole = covered(from_ns, from_ns + length_ns, pause) >= 0.5
    silent = (between == 0) & (length_ns > max(_SILENT_S, 5.0 * regular.period_s) * 1e9) & ~whole
    spans = {
        "gnss.fix_lost": _spans(from_ns, length_ns, between > 0),
        "gnss.silent": _spans(from_ns, length_ns, silent),
    }
    last = int(receiver.stamp_ns[good[-1]])
    end = max(last, ends_ns(log) or last)
    if end - last > max(_SILENT_S, 5.0 * regular.period_s) * 1e9:
        spans["gnss.fix_lost" if good[-1] < len(fixed) - 1 else "gnss.silent"].append((last, end))
    findings = []
    for key, found in spans.items():
        if not found:
            continue
        armed = armed_rows(log, np.array([b for _, b in found], dtype=np.int64))
        times = some([f"{instants.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in found])
        did = "lost its fix" if key == "gnss.fix_lost" else "said nothing"
        ended = ", to the end of the log" if found[-1] == (last, end) else ""
        findings.append(
            Finding(
                key,
                Severity.WARNING if armed is None or armed.any() else Severity.NOTICE,
                f"{receiver.name} {did} {_times(len(found))} (it comes every {regular.period_s * 1e3:.0f} ms): "
                f"at {times}{ended}",
                tuple(Evidence(receiver.message, receiver.fields["fix"], a, b) for a, b in found[:8]),
                "Look at satellites and interference then, at wiring and baud rate, and at what the estimator did "
                "without.",
            )
        )
    return findings


def _spans(
    from_ns: NDArray[np.int64], length_ns: NDArray[np.int64], chosen: NDArray[np.bool_]
) -> list[tuple[int, int]]:
    return [(int(a), int(a) + int(d)) for a, d in zip(from_ns[chosen], length_ns[chosen], strict=True)]


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
