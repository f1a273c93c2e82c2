"""Analyses of logs that plug-ins add to those of `xitl_cli.logs`, which imports nothing else of xitl_cli."""

from __future__ import annotations

from collections.abc import Collection

from xitl_cli.logs.analyses.catalogue import AddedAnalysis
from xitl_cli.logs.report.build import SECTIONS
from xitl_cli.registry import LOG_ANALYSES, load, load_all, names, package_of


def added_analyses(sections: Collection[str] = ()) -> list[AddedAnalysis]:
    """Every analysis of plug-ins that can be loaded. An analysis with the name of a built-in section is left out.

    sections: names that the user asks for. Raises PluginError for one of them that a plug-in registers and that cannot
    be loaded.
    """

    for name in set(sections) & set(names(LOG_ANALYSES)) - set(SECTIONS):
        load(LOG_ANALYSES, name)
    return [
        AddedAnalysis(name, package_of(LOG_ANALYSES, name), analyse)
        for name, analyse in load_all(LOG_ANALYSES)
        if name not in SECTIONS
    ]
