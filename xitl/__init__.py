"""The public Python API: run profiles, read and analyse logs, compute the WDRI.

    import xitl

    result = xitl.simulate("sitl", seed=7, overrides={"environment.wind.mean_mps": 8})
    print(result.summary["mission"]["cross_track_rms_m"])
    with result.open_log() as log:
        state = log["/truth/state"]

`import xitl` is fast: each part is loaded at its first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from agent import __version__

if TYPE_CHECKING:
    from xitl_cli.api import (
        Result,
        analyze,
        campaign,
        compare,
        load_profile,
        open_log,
        paper,
        picture,
        replay_html,
        simulate,
        wdri,
    )
    from xitl_cli.errors import UserError
    from xitl_cli.logs.model.errors import LogError

__all__ = [
    "LogError",
    "Result",
    "UserError",
    "__version__",
    "analyze",
    "campaign",
    "compare",
    "load_profile",
    "open_log",
    "paper",
    "picture",
    "replay_html",
    "simulate",
    "wdri",
]


_ERRORS = {"LogError": "xitl_cli.logs.model.errors", "UserError": "xitl_cli.errors"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'xitl' has no attribute {name!r}; it has {', '.join(sorted(__all__))}")
    return getattr(import_module(_ERRORS.get(name, "xitl_cli.api")), name)


def __dir__() -> list[str]:
    return sorted(__all__)
