"""`xitl init`: the files of a boat of one's own are right from the beginning, and nobody's other files are touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from xitl_cli.commands.init import FILES, init
from xitl_cli.errors import UserError
from xitl_cli.profile import load_with_origins


@pytest.fixture(autouse=True)
def _empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["my-boat", "null", "1e3", "fleet/boat.2"])
def test_what_it_writes_runs_and_has_nothing_of_another_boat(name: str) -> None:
    init(Path(name))
    for written in (name, f"{name}/", f"{name}/profile.yaml"):
        loaded = load_with_origins(written)
        assert loaded.warnings == ()
        run = loaded.profile.runnable()
        assert run.name == run.vehicle.name == run.site.name == Path(name).name
    assert run.world.dam is run.world.log_boom is None
    assert run.autopilot.parameter_files == ()
    for file in FILES:
        text = (Path(name) / file).read_text()
        assert text.startswith("# ")
        assert "NAME" not in text
        assert max(map(len, text.splitlines())) <= 160


def test_the_hulls_that_it_shows_in_comments_float() -> None:
    """With the comment signs taken away, and the short form with them; all but the mesh, which is not there."""
    init(Path("my-boat"))
    lines = Path("my-boat/vessel.yaml").read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if line.endswith("# hulls:"))
    last = next(number for number, line in enumerate(lines) if line.startswith("  added_mass"))
    shown = [
        line.replace("  # ", "  ", 1)
        for line in lines[first:last]
        if line.startswith("  #   ") or line.endswith("# hulls:")
    ]
    text = [line for line in lines if not line.strip().startswith(("#", "hull:"))]
    at = next(number for number, line in enumerate(text) if line.startswith("  added_mass"))
    hulls = [line for line in shown if "mesh" not in line]
    Path("my-boat/vessel.yaml").write_text("\n".join([*text[:at], *hulls, *text[at:]]))
    vehicle = load_with_origins("my-boat").profile.vehicle
    assert vehicle is not None
    assert len(vehicle.demi_hulls) == 3
    Path("my-boat/vessel.yaml").write_text("\n".join([*text[:at], *shown, *text[at:]]))
    with pytest.raises(UserError, match=r"vehicle\.hulls\.3\.mesh\.file = .*hull\.stl does not exist"):
        load_with_origins("my-boat")


def test_the_fleet_that_it_shows_in_comments_loads() -> None:
    init(Path("my-boat"))
    file = Path("my-boat/profile.yaml")
    text, mark, fleet = file.read_text().partition("# vessels:")
    file.write_text(text + (mark + fleet).replace("# ", ""))
    loaded = load_with_origins("my-boat")
    assert [*loaded.profile.sailed] == ["leader", "follower_1", "follower_2", "follower_3"]
    assert loaded.warnings == ()


def test_it_says_what_to_edit_and_in_which_order(capsys: pytest.CaptureFixture[str]) -> None:
    init(Path("my-boat"))
    said = capsys.readouterr().out
    places = [said.index(f"my-boat/{file}") for file in ("vessel.yaml", "mission.yaml", "profile.yaml")]
    assert places == sorted(places)
    assert max(map(len, said.splitlines())) <= 80


def test_what_is_there_is_left_alone() -> None:
    Path("my-boat").mkdir()
    Path("my-boat/vessel.yaml").write_text("mine")
    Path("file").write_text("mine")
    for name in ("my-boat", "file"):
        with pytest.raises(UserError, match="exists; choose another name"):
            init(Path(name))
    assert Path("my-boat/vessel.yaml").read_text() == "mine"
    assert [path.name for path in Path("my-boat").iterdir()] == ["vessel.yaml"]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("sitl", "comes with xitl"),
        ("calm", "comes with xitl"),
        *((name, "no valid name") for name in ("a b", "", "-x", "é")),
    ],
)
def test_names_that_would_not_be_found_again_are_refused(name: str, why: str) -> None:
    with pytest.raises(UserError, match=why):
        init(Path(name))
    with pytest.raises(UserError, match="no valid name"):
        init(Path("a" * 65))
    assert list(Path().iterdir()) == []
