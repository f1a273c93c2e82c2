"""The public Python API: run profiles, read and analyse logs, compute the WDRI, make environments for learning.

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
        compare,
        load_profile,
        open_log,
        simulate,
        wdri,
    )
    from xitl_cli.errors import UserError
    from xitl_cli.logs.model.errors import LogError
    from xitl_cli.plugins.campaign.api import campaign
    from xitl_cli.plugins.learning.api import Vessels, make_env, make_vec_env
    from xitl_cli.plugins.studies.api import paper
    from xitl_cli.plugins.view.plugin import picture, replay_html

__all__ = [
    "LogError",
    "Result",
    "UserError",
    "Vessels",
    "__version__",
    "analyze",
    "campaign",
    "compare",
    "load_profile",
    "make_env",
    "make_vec_env",
    "open_log",
    "paper",
    "picture",
    "replay_html",
    "simulate",
    "wdri",
]


_ELSEWHERE = {
    "LogError": "xitl_cli.logs.model.errors",
    "UserError": "xitl_cli.errors",
    "Vessels": "xitl_cli.plugins.learning.api",
    "campaign": "xitl_cli.plugins.campaign.api",
    "make_env": "xitl_cli.plugins.learning.api",
    "make_vec_env": "xitl_cli.plugins.learning.api",
    "paper": "xitl_cli.plugins.studies.api",
    "picture": "xitl_cli.plugins.view.plugin",
    "replay_html": "xitl_cli.plugins.view.plugin",
}
"""The module of each name that is not in `xitl_cli.api`."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'xitl' has no attribute {name!r}; it has {', '.join(sorted(__all__))}")
    try:
        module = import_module(_ELSEWHERE.get(name, "xitl_cli.api"))
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("xitl_cli.plugins"):
            raise
        from xitl_cli.registry import PluginError

        raise PluginError(f"xitl.{name}: the plug-in is not installed; pip install --force-reinstall xitl") from error
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)
