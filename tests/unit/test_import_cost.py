"""What is loaded before anything is asked for: heavy packages only where they are used."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from tempfile import TemporaryDirectory

import pytest

HEAVY = ("numpy", "scipy", "pydantic", "yaml", "foxglove", "mcap", "pymavlink", "can", "serial", "kiss_icp", "pygeomag")
OF_EXTRAS = (
    "scipy",
    "kiss_icp",
    "dask",
    "distributed",
    "pandas",
    "pyarrow",
    "plotly",
    "matplotlib",
    "viser",
    "optuna",
    "gymnasium",
)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("loading", "allowed"),
    [
        ("from xitl_cli.main import _app; _app()", set()),
        ("import agent.__main__", set()),
        ("import sim_core.simulation, sim_core.sensors", {"numpy"}),
        ("import xitl_cli.profile, xitl_cli.graph.wdri, xitl_cli.run.run_graph", {"yaml"}),
        ("import xitl_cli.run.session", {"numpy", "yaml", "foxglove", "mcap"}),
    ],
)
def test_nothing_heavy_is_loaded_beforehand(loading: str, allowed: set[str]) -> None:
    program = f"{loading}\nimport sys\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(told.stdout.split()) <= allowed


@pytest.mark.medium
def test_the_results_of_a_companion_need_none_of_its_algorithms() -> None:
    program = "import xitl_cli.run.nodes.findings\nimport sys\nprint(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert {"agent.companion.odometry", "agent.companion.tracking"}.isdisjoint(ran.stdout.split())


@pytest.mark.medium
def test_an_agent_collects_garbage_seldom() -> None:
    program = "import gc\nfrom agent.__main__ import main\nmain(['--link', 'nowhere://'])\nprint(gc.get_threshold()[0])"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert int(ran.stdout.split()[-1]) >= 10_000, ran.stderr


OWN = ("agent", "sim_core", "xitl_cli")
NOT_IN_SITL = (
    "agent.companion.settings",
    "agent.wire.socket_pair",
    "pydantic",
    "sim_core.sensors.lidar",
    "sim_core.sensors.radar",
    "sim_core.sensors.rangefinder",
    "sim_core.sensors.sonar",
    "xitl_cli.logs.formats.dataflash",
    "xitl_cli.logs.signals.motion",
    "xitl_cli.mapping",
    "xitl_cli.profile.missions.map_files",
    "xitl_cli.replay.motor_schedule",
    "xitl_cli.run.links.loopback",
    "xitl_cli.run.nodes.bridge",
    "xitl_cli.run.nodes.findings",
    "xitl_cli.run.nodes.operator",
    "xitl_cli.run.nodes.river",
    "xitl_cli.run.operator.actions",
)
"""Modules of other profiles than sitl, and pydantic, with which typer converts unusual values."""


SIM = ("sim", "sitl", "--duration", "0.1", "--seed", "3", "--set", "clock.seed=2", "--out", "run", "--overwrite")


@cache
def loaded_by(arguments: tuple[str, ...]) -> tuple[int, list[str]]:
    """Return how often a command reads entry points, and the names of all modules that it imports."""
    program = (
        "import sys\nfrom xitl_cli import registry\nfrom xitl_cli.main import main\n"
        "read, reads = registry.ranked_entry_points, []\n"
        "registry.ranked_entry_points = lambda prefix: reads.append(prefix) or read(prefix)\n"
        f"sys.argv = ['xitl', *{arguments!r}]\n"
        "try: main()\nfinally: print(len(reads), *sys.modules, file=sys.stderr)"
    )
    with TemporaryDirectory() as folder:
        ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder, check=False)
    assert ran.returncode == 0, ran.stderr
    reads, *modules = ran.stderr.split()
    return int(reads), modules


@pytest.mark.medium
@pytest.mark.parametrize(("arguments", "most"), [(("--help",), 32), (SIM, 304)])
def test_commands_import_few_modules_of_xitl(arguments: tuple[str, ...], most: int) -> None:
    _, modules = loaded_by(arguments)
    assert len([name for name in modules if name.split(".")[0] in OWN]) <= most


@pytest.mark.medium
def test_a_run_imports_no_module_of_other_profiles() -> None:
    _, modules = loaded_by(SIM)
    assert set(NOT_IN_SITL).isdisjoint(modules)


@pytest.mark.medium
@pytest.mark.parametrize("arguments", [("campaign", "controllers", "--dry-run"), ("--help",), ("profiles", "list")])
def test_commands_of_a_base_install_run_without_packages_of_extras(arguments: tuple[str, ...]) -> None:
    program = (
        f"import sys\nfor name in {OF_EXTRAS!r}: sys.modules[name] = None\n"
        f"sys.argv = ['xitl', *{arguments!r}]\nfrom xitl_cli.main import main\nmain()"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.medium
@pytest.mark.parametrize(
    ("arguments", "most"), [(SIM, 1), (("wdri", "sitl"), 1), (("profiles", "show", "sitl"), 1), (("doctor", "-h"), 0)]
)
def test_core_commands_load_no_plug_in_and_read_entry_points_once(arguments: tuple[str, ...], most: int) -> None:
    reads, modules = loaded_by(arguments)
    assert [name for name in modules if name.startswith("xitl_cli.plugins")] == []
    assert reads <= most
