"""What is loaded before anything is asked for: heavy packages only where they are used."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

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


@pytest.mark.parametrize("arguments", [("campaign", "controllers", "--dry-run"), ("--help",), ("profiles", "list")])
def test_commands_of_a_base_install_run_without_packages_of_extras(arguments: tuple[str, ...]) -> None:
    program = (
        f"import sys\nfor name in {OF_EXTRAS!r}: sys.modules[name] = None\n"
        f"sys.argv = ['xitl', *{arguments!r}]\nfrom xitl_cli.main import main\nmain()"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize(
    ("arguments", "most"),
    [
        (("sim", "--duration", "0.1"), 1),
        (("wdri", "sitl"), 1),
        (("profiles", "show", "sitl"), 1),
        (("doctor", "-h"), 0),
    ],
)
def test_core_commands_load_no_plug_in_and_read_entry_points_once(
    tmp_path: Path, arguments: tuple[str, ...], most: int
) -> None:
    program = (
        "import sys\nfrom xitl_cli import registry\nfrom xitl_cli.main import main\n"
        "read, reads = registry.ranked_entry_points, []\n"
        "registry.ranked_entry_points = lambda prefix: reads.append(prefix) or read(prefix)\n"
        f"sys.argv = ['xitl', *{arguments!r}]\n"
        "try: main()\n"
        "finally: print(len(reads), *[name for name in sys.modules if name.startswith('xitl_cli.plugins')],"
        " file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, check=False)
    reads, *loaded = ran.stderr.split()
    assert (ran.returncode, loaded) == (0, []), ran.stderr
    assert int(reads) <= most
