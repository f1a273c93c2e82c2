"""What is loaded before anything is asked for: heavy packages only where they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numpy", "scipy", "pydantic", "yaml", "foxglove", "mcap", "pymavlink", "can", "serial", "kiss_icp", "pygeomag")
OF_EXTRAS = ("scipy", "kiss_icp", "dask", "distributed", "pandas", "pyarrow", "plotly", "matplotlib", "viser", "optuna")


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
