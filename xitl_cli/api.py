"""The functions behind `import xitl`: what the commands do, without printing and with objects for results."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from xitl_cli.errors import UserError
from xitl_cli.profile import Profile, load_with_origins
from xitl_cli.profile import load_profile as _load_profile
from xitl_cli.run.session import Result

if TYPE_CHECKING:
    from xitl_cli.graph.wdri import FleetWdri, VertexCount, Wdri
    from xitl_cli.logs.compare.comparison import Comparison
    from xitl_cli.logs.model.log import Log
    from xitl_cli.logs.report.model import Report

__all__ = [
    "Result",
    "analyze",
    "compare",
    "load_profile",
    "open_log",
    "simulate",
    "wdri",
]

PathText = str | PathLike[str]
Overrides = Mapping[str, Any] | Iterable[str]


def load_profile(name: PathText, overrides: Overrides = ()) -> Profile:
    """The checked profile `name`: a shipped one (`"sitl"`) or the path of a YAML file.

    overrides: values by dotted key, `{"environment.wind.mean_mps": 8}`, or texts as for `--set`,
    `["environment.wind.mean_mps=8"]`.

    Raises UserError for an unknown name, and for every error in the profile, with file, line, key and fix.
    """
    return _load_profile(fspath(name), _texts(overrides))


def simulate(
    profile: PathText | Profile = "sitl",
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    overrides: Overrides = (),
    out: PathText | None = None,
    overwrite: bool = False,
) -> Result:
    """Run a profile, as `xitl sim` does, and keep the run in a directory.

    profile: a name, a path, or a Profile from `load_profile`. seed: seed of all random values. duration_s: simulated
    time from the start at which the run ends; it replaces the profile's limit. overrides: as for `load_profile`. Give
    seed, duration_s and overrides only with a name or a path. out: the run directory, by default
    `runs/<profile>-<time>` in the working directory. overwrite: replace an earlier run there.

    A run with an incomplete mission is a result (`completed` is False). So is a real-time run that did not keep real
    time (`verdict`). Raises UserError when the profile cannot run, and when the run failed. The data recorded until
    then is kept.
    """
    from xitl_cli.run.core.directory import default_path
    from xitl_cli.run.nodes.display import NoDisplay
    from xitl_cli.run.session import run

    clock = {"clock.seed": seed, "clock.duration_s": duration_s}
    clock_overrides = {key: value for key, value in clock.items() if value is not None}
    warnings: tuple[str, ...] = ()
    if isinstance(profile, Profile):
        if clock_overrides or overrides:
            raise UserError(f"{profile.name} is loaded already; give seed, duration_s and overrides to load_profile")
    else:
        loaded = load_with_origins(fspath(profile), [*_texts(overrides), *_texts(clock_overrides)])
        profile, warnings = loaded.profile, loaded.warnings
    directory = default_path(profile.name) if out is None else Path(out)
    result = run(profile, directory, overwrite, NoDisplay, timed=duration_s is not None, warnings=warnings)
    if result.summary["error"]:
        raise UserError(f"{result.summary['error']} (the recording until then is in {result.directory})")
    return result


def wdri(
    profile: PathText | Profile,
    *,
    overrides: Overrides = (),
    reference: PathText | None = None,
    vertices: VertexCount | None = None,
    vessel: str | None = None,
) -> Wdri | FleetWdri:
    """The weighted degree realism index of a profile, from 0 to 1, with its graph.

    reference: a profile, or `"complete"` for the graph in which every node is real and linked to every node; by default
    the profile's own. vertices: number of vertices for the mean degree: `"architecture"`, `"present"` or a number.
    vessel: one vessel of a fleet. Without it, a fleet returns the index of each of its `vessels`, and their mean.
    """
    from xitl_cli.graph.wdri import fleet_wdri, profile_wdri

    loaded = profile if isinstance(profile, Profile) else load_profile(profile, overrides)
    reference_name = None if reference is None else fspath(reference)
    if vessel is None and loaded.vessels is not None:
        return fleet_wdri(loaded, reference_name, vertices)
    return profile_wdri(loaded if vessel is None else loaded.vessel(vessel), reference_name, vertices)


def open_log(path: PathText, vessel: str | None = None) -> Log:
    """A log opened for reading: DataFlash `.bin`, ULog `.ulg`, MAVLink `.tlog`, MCAP or a ROS bag.

    vessel: one vessel of a fleet's recording; its topics then have no prefix. Without it, all topics have their full
    names.

    `log["ATT"]` is a table, `log["ATT"]["Roll"]` its column as a numpy array, `log["ATT"].to_pandas()` a data frame
    (needs pandas). Close the log, or use it in a `with`. Raises LogError for a file that cannot be read.
    """
    from xitl_cli.logs import open_log as open_path

    return open_path(Path(path), vessel)


def analyze(*logs: PathText, sections: str | Iterable[str] = (), vessel: str = "") -> Report:
    """All analyses of one or several logs of a run, as `xitl logs analyze`: findings with evidence and next step.

    sections: names of analyses (`"scheduler"`), by default all, with those of plug-ins. vessel: one vessel of a
    fleet's recording, by default the first.

    A log that cannot be read is in the report's `refusals`. Raises LogError for an unknown section.
    """
    from xitl_cli.log_analyses import log_analyses, sections_named
    from xitl_cli.logs.report.build import OVERVIEW, build_report

    wanted = sections_named((sections,) if isinstance(sections, str) else tuple(sections))
    overview = not wanted or OVERVIEW in wanted
    return build_report([Path(log) for log in logs], log_analyses(wanted), vessel=vessel, overview=overview)


def compare(
    a: PathText,
    b: PathText,
    *,
    align: Literal["none", "origin", "se3", "sim3"] = "none",
    start: Literal["auto", "clocks", "mission", "armed", "motion", "correlation"] = "auto",
    of_a: Literal["estimate", "truth"] = "estimate",
    of_b: Literal["estimate", "truth"] = "estimate",
    armed: bool = False,
    vessel: str = "",
    vessel_b: str = "",
) -> Comparison:
    """Log `b` against log `a`, as `xitl logs compare`: trajectories, motion, channels, events.

    align: method that aligns b's path with a's before errors are computed. start: method that aligns b with a's time.
    of_a, of_b: the autopilot's estimate or the simulator's truth. armed: use only the time in which both were armed.
    vessel: one vessel of a fleet's recording, by default the first. vessel_b: another vessel for `b`.
    """
    from xitl_cli.log_analyses import log_analyses
    from xitl_cli.logs.compare.comparison import OVERLAID
    from xitl_cli.logs.compare.comparison import compare as compare_logs

    overlaid = log_analyses(OVERLAID)
    with open_log(a, vessel) as log_a, open_log(b, vessel_b or vessel) as log_b:
        return compare_logs(
            log_a, log_b, align=align, start=start, of_a=of_a, of_b=of_b, armed=armed, analyses=overlaid
        )


def _texts(overrides: Overrides) -> list[str]:
    def plain(value: Any) -> Any:
        """A path as text, a number or array of numpy as Python's own. Raises TypeError for anything else."""
        return value.tolist() if hasattr(value, "tolist") else fspath(value)

    if isinstance(overrides, Mapping):
        return [f"{key}={json.dumps(value, default=plain)}" for key, value in overrides.items()]
    return [overrides] if isinstance(overrides, str) else list(overrides)
