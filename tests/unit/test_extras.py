"""What a base install lacks is named with the line that brings it, and nothing of it is loaded without need."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.recorded import CALM
from xitl_cli.extras import EXTRAS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OPTIONAL = (
    "plotly", "scipy", "pandas", "pyarrow", "kiss_icp", "embreex", "trimesh", "dask", "distributed", "optuna", "SALib",
    "matplotlib",
)  # fmt: skip


def base_install(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`xitl ARGUMENTS` as where no extra is installed."""
    program = f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL!r})); from xitl_cli.main import main; main()"
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("extra", "arguments"),
    [
        ("report", ("logs", "plot", str(CALM), "ATT.Roll", "--out", "plot.html")),
        ("parquet", ("logs", "export", str(CALM), "ATT", "--format", "parquet", "--out", "folder")),
        ("perception", ("map", "run.mcap")),
        ("campaign", ("campaign", "environments")),
        ("figures", ("paper", "wdri", "--report")),
        ("report", ("board", "compare")),
        ("perception", ("sim", "sitl-perception", "--duration", "1")),
    ],
)
def test_a_command_names_the_extra_that_it_needs(extra: str, arguments: tuple[str, ...], tmp_path: Path) -> None:
    told = base_install(tmp_path, *arguments)
    assert told.returncode == 2, told.stderr
    assert f"pip install 'xitl[{extra}]'" in told.stderr
    assert len(told.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "plot.html").exists()


def test_the_base_needs_none_of_it() -> None:
    base = {re.split(r"[<>=]", package)[0].lower() for package in PROJECT["dependencies"]}
    assert base.isdisjoint({"plotly", "scipy", "pandas", "pyarrow", "kiss-icp", "embreex", "trimesh"})
    assert "matplotlib" not in base


def test_each_extra_is_declared_and_brings_what_is_asked_for() -> None:
    declared = PROJECT["optional-dependencies"]
    names = {"kiss_icp": "kiss-icp", "PIL": "pillow", "cv2": "opencv-python-headless"}
    for extra in EXTRAS:
        brought = {re.split(r"[<>=]", package)[0] for package in declared[extra.name]}
        assert {names.get(package, package) for package in extra.packages} <= brought
    (everything,) = declared["all"]
    assert set(re.fullmatch(r"xitl\[(.*)\]", everything)[1].split(",")) == {extra.name for extra in EXTRAS}  # type: ignore[index]


def test_the_page_of_the_install_states_the_size_of_each_extra() -> None:
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    for extra in EXTRAS:
        assert re.search(rf"\| `xitl\[{extra.name}\]` \|.*\d+ MB", page), extra.name
    assert re.search(r"\| `xitl` \|.*\d+ MB", page)
