"""Keys of a tide: files, inheritance, and errors with file, line, key and fix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from sim_core.environment.tide import NO_TIDE, make_tide
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.load import recorded_profiles

Write = Callable[..., Path]

BOAT = "extends: mitl\nclock: {duration_s: 3600}\n"
M2 = "{name: M2, amplitude_m: 2.0, phase_deg: 300}"


def tidal(tide: str, more: str = "", start: str = "2026-03-01T06:00:00Z") -> str:
    begin = f"  start_utc: {start}\n" if start else ""
    return f"{BOAT}environment:\n{begin}  water:\n    tide: {tide}\n{more}"


def height_m(name: Path, time_s: float) -> float:
    environment = load_profile(str(name)).environment
    assert environment is not None
    return make_tide(environment).height_m(time_s)


@pytest.mark.medium
def test_constituents_change_the_level_over_an_hour(write: Write) -> None:
    name = write(tidal(f"{{constituents: [{M2}]}}"))
    profile = load_profile(str(name))
    assert height_m(name, 0.0) == pytest.approx(1.0116, abs=1e-3)
    assert height_m(name, 3600.0) == pytest.approx(1.6821, abs=1e-3)
    read = recorded_profiles(resolved_yaml(profile).encode())[0]
    assert make_tide(read.environment).height_m(1800.0) == pytest.approx(height_m(name, 1800.0))


def test_a_profile_without_a_tide_has_no_key_of_it() -> None:
    profile = load_profile("mitl")
    assert profile.environment is not None
    assert make_tide(profile.environment) is NO_TIDE
    text = resolved_yaml(profile)
    assert "tide" not in text
    assert "start_utc" not in text


@pytest.mark.parametrize(
    "rows",
    [
        "Date Time, Prediction, Type\n2026-03-01 05:00, 1.0, L\n2026-03-01 08:00, 2.0, H\n",
        "# of the harbour\ntime_s,height_m\n\n-3600,1\n7200,2\n",
        "\ufeff-3600,1\n7200,2",
    ],
)
def test_a_file_is_read_beside_its_profile(write: Write, rows: str) -> None:
    write(rows, "parts/tide.csv")
    write(tidal("{file: tide.csv}"), "parts/harbour.yaml")
    name = write("extends: parts/harbour.yaml\n")
    assert height_m(name, -3600.0) == pytest.approx(1.0)
    assert height_m(name, 1800.0) == pytest.approx(1.5)
    profile = load_profile(str(name))
    assert "tide.csv" not in resolved_yaml(profile)  # the rows travel with the profile


def test_a_form_replaces_an_inherited_one(write: Write) -> None:
    write(tidal(f"{{constituents: [{M2}]}}", "  current: {tide: {flood_deg: 20, peak_mps: 0.5}}\n"), "sea.yaml")
    own = "{constituents: [{name: M2, amplitude_mps: 0.4, phase_deg: 12}]}"
    text = "extends: sea.yaml\nenvironment:\n  water: {tide: {table: [[0, 0.5], [3600, 0.7]]}}\n"
    name = write(f"{text}  current: {{tide: {own}}}\n")
    assert height_m(name, 3600.0) == pytest.approx(0.7)
    environment = load_profile(str(name)).environment
    assert environment is not None
    assert environment.current.tide is not None
    assert environment.current.tide.peak_mps is None


def test_an_override_sets_a_key_of_a_tide(write: Write) -> None:
    name = write(tidal(f"{{constituents: [{M2}]}}"))
    profile = load_profile(str(name), ["environment.water.tide.constituents.0.amplitude_m=0.5"])
    assert profile.environment is not None
    assert make_tide(profile.environment).height_m(0.0) == pytest.approx(0.2529, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "line", "sentence"),
    [
        (tidal(f"{{constituents: [{M2}]}}", start=""), 5, "environment.water.tide needs environment.start_utc; add it"),
        (
            tidal(f"{{constituents: [{M2}]}}", start="yesterday"),
            4,
            "environment.start_utc = 'yesterday' is not a date and time",
        ),
        (
            tidal("{constituents: [{name: m2, amplitude_m: 1, phase_deg: 0}]}"),
            6,
            "environment.water.tide.constituents.0.name = m2 is not a known constituent; did you mean 'M2'?",
        ),
        (
            tidal("{constituents: [{name: M2, amplitude_m: 1, phase_deg: 0, speed_degph: 29}]}"),
            6,
            "constituents.0.speed_degph = 29 is redundant, because the speed of M2 is known; leave it out",
        ),
        (tidal("{constituents: [{name: M2, phase_deg: 0}]}"), 6, "needs 'amplitude_m'; add it in m"),
        (tidal("{}"), 6, "environment.water.tide is empty; give either constituents, or a table or file"),
        (tidal("{table: [[0, 1], [0, 2]]}"), 6, "environment.water.tide.table.1.0 = 0 is not after 0; sort the rows"),
        (tidal("{table: [[0, 1], [3600, .nan]]}"), 6, "environment.water.tide.table.1.1 = nan is not finite"),
        (tidal("{table: [[0, 1], [3600]]}"), 6, "environment.water.tide.table.1 = a list of 1 is too short"),
        (
            tidal("{table: [[0, 1], [.inf, 2]]}"),
            6,
            "table.1.0 = inf is not a time; write seconds since the start, or UTC",
        ),
        (tidal("{table: [[0, 1], [1800, 2]]}"), 6, "table ends at 1800 s, but the run needs it to 3600 s; add rows"),
        (tidal("{table: [[60, 1], [3600, 2]]}"), 6, "table begins at 60 s, but the run needs it from 0 s; add rows"),
        (tidal("{file: none.csv}"), 6, "none.csv cannot be read: no such file or directory; check the path"),
        (tidal("{file: 3}"), 6, "environment.water.tide.file = 3 is not text; write the path of a CSV file"),
        (
            f"{BOAT}environment:\n  current:\n    tide: {{flood_deg: 20, peak_mps: 1}}\n",
            5,
            "environment.current.tide.follows = level_rate needs environment.water.tide; add it",
        ),
        (
            tidal("{table: [[0, 1], [3600, 2]]}", "  current:\n    tide: {flood_deg: 20}\n"),
            8,
            "environment.current.tide.peak_mps is missing; give either peak_mps or constituents",
        ),
    ],
)
def test_errors_name_the_line_the_key_and_the_fix(write: Write, text: str, line: int, sentence: str) -> None:
    with pytest.raises(ProfileError) as error:
        load_profile(str(write(text)))
    (problem,) = error.value.problems
    assert (problem.origin.source, problem.origin.line) == ("boat.yaml", line)
    assert sentence in problem.sentence


@pytest.mark.parametrize(
    ("rows", "line", "sentence"),
    [
        (
            "0,1\n" + "x" * 200_000 + ",2\n",
            2,
            "is not CSV (field larger than field limit (131072)); write a time and a height",
        ),
        (
            "time,height\n0,1\n1800,high\n",
            3,
            "'1800, high' is not a row of time and height; write for example 3600, 0.42",
        ),
        ("0,1\n\n7200,2\n3600,1\n", 4, "environment.water.tide.table.2.0 = 3600 is not after 7200; sort the rows"),
        ("0,1\n3600,nan\n", 2, "environment.water.tide.table.1.1 = nan is not finite"),
        ("0,1\nnoon,2\n", 2, "environment.water.tide.table.1.0 = 'noon' is not a date and time"),
        ("time,height\n", None, "has no rows; write a time and a height in each row"),
    ],
)
def test_errors_in_a_file_name_its_line(write: Write, rows: str, line: int | None, sentence: str) -> None:
    write(rows, "tide.csv")
    with pytest.raises(ProfileError) as error:
        load_profile(str(write(tidal("{file: tide.csv}"))))
    (problem,) = error.value.problems
    assert (problem.origin.source, problem.origin.line) == ("tide.csv", line)
    assert sentence in problem.sentence
