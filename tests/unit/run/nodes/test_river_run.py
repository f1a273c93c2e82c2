"""A run in a river: what the profile asks for is in the water, in the recording and in the summary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.random import default_rng

from sim_core.world.waterway import OPEN_WATER
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.nodes.river import river_from_profile
from xitl_cli.run.session import run
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_simulation
from xitl_cli.seeds import Seeds

LAUNCHES = (
    "world.debris.launches=[{kind: trunk, pos_ned_m: [9.0, -14.5], heading_deg: 126.9, at_s: 1.0}, "
    "{kind: plants, pos_ned_m: [60.0, 20.0], length_m: 2.0}]"
)


def said(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages([topic])]


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("river") / "run"
    profile = load_profile("mitl", ["world.contact=true", LAUNCHES, "clock.duration_s=12.0"])
    return run(profile, out, False, NoDisplay).summary, out / "run.mcap"


@pytest.mark.medium
def test_the_summary_tells_what_was_launched_and_hit(ended: tuple[dict[str, Any], Path]) -> None:
    summary, _ = ended
    assert summary["error"] is None
    assert summary["debris"]["launched"] == 2
    assert summary["debris"]["by"] == {"plants": 1, "trunk": 1}
    collisions = summary["collisions"]
    assert collisions["count"] == len(collisions["list"])
    assert set(collisions["by"]) <= {"trunk", "log boom"}


@pytest.mark.medium
def test_the_recording_has_the_bodies(ended: tuple[dict[str, Any], Path]) -> None:
    bodies = said(ended[1], "/truth/bodies")
    assert {(body.number, body.kind) for body in bodies} == {(0, "plants"), (1, "trunk")}
    assert len([body for body in bodies if body.number == 0]) == pytest.approx(120, abs=2)  # 10 Hz
    assert len([body for body in bodies if body.number == 1]) == pytest.approx(110, abs=2)


@pytest.mark.medium
def test_the_bodies_are_drawn_where_they_are(ended: tuple[dict[str, Any], Path]) -> None:
    draw_encounters, placed = [], {}
    with ended[1].open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(["/scene", "/tf"]):
            assert schema is not None
            if channel.topic == "/scene":
                draw_encounters.append((message.log_time, b"body_0" in message.data, b"body_1" in message.data))
            else:
                placed.update({name: True for name in (b"body_0", b"body_1") if name in message.data})
    assert [row[1:] for row in draw_encounters] == [(False, False), (True, False), (False, True)]
    assert draw_encounters[2][0] == pytest.approx(1_000_000_000, abs=20_000_000)
    assert len(placed) == 2


@pytest.mark.medium
def test_every_collision_is_in_the_recording(ended: tuple[dict[str, Any], Path]) -> None:
    summary, path = ended
    began = [contact for contact in said(path, "/contacts") if contact.began] if summary["collisions"]["count"] else []
    assert [contact.what for contact in began] == [row["what"] for row in summary["collisions"]["list"]]


@pytest.mark.medium
def test_without_a_word_in_the_profile_it_is_open_water() -> None:
    profile = load_profile("sitl").runnable()
    simulation, _ = build_simulation(profile, Seeds(1))
    assert simulation.waterway is OPEN_WATER


@pytest.mark.medium
def test_what_stands_in_the_river_of_the_profile_is_felt() -> None:
    profile = load_profile("sitl", ["world.contact=true"]).runnable()
    standing = build_simulation(profile, Seeds(1))[0].waterway.standing
    assert set(standing.names) == {"log boom", "dam"}
    boom, dam = profile.world.log_boom, profile.world.dam
    assert boom is not None
    assert boom.points_ned_m is not None
    assert dam is not None
    middle = np.array([[(a + b) / 2 for a, b in zip(boom.points_ned_m[0][:2], boom.points_ned_m[1][:2], strict=True)]])
    assert -boom.float_radius_m <= standing.distance_m(middle).min() < 0.3  # on a float, or in the gap between two
    across = np.radians(dam.heading_deg + 90.0)
    before = np.array([dam.centre_ned_m[:2]]) - 15.0 * np.array([np.cos(across), np.sin(across)])
    assert standing.distance_m(before).min() == pytest.approx(15.0 - dam.size_m[1] / 2)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("world.debris.control=tcp://127.0.0.1:1", "is not UDP"),
        ("world.debris.control=nowhere", "is not a link"),
        ("world.debris.encounters={count: 2, kinds: []}", "kinds is empty; add one of trunk"),
        ("world.debris.encounters={count: 2, ahead_m: [60.0, 40.0]}", "write the nearer first"),
        (
            "world.debris.launches=[{pos_ned_m: [0.0, 0.0], length_m: 80.0}]",
            "use a value of at most 50 in m",
        ),
        ("world.debris.launches=[{pos_ned_m: [0.0, 0.0], kind: whale}]", "kind"),
        ("world.debris.launches=[{pos_ned_m: [0.0, 0.0], windage: 2}]", r"windage = 2 is too large"),
        ("world.buoys=[{shape: can}]", r"world\.buoys\.0 needs 'pos_ned_m'; add it"),
        (
            "world.buoys=[{pos_ned_m: [0.0, 0.0], colour: yelow}]",
            r"buoys\.0\.colour = 'yelow' is .*did you mean 'yellow'",
        ),
        (
            "world.buoys=[{pos_ned_m: [0.0, 0.0], diameter_m: 9}]",
            r"buoys\.0\.diameter_m = 9 is too large; use .* 5 in m",
        ),
        ("world.buoys=[{pos_ned_m: [0.0, 0.0], depth_m: 3}]", r"buoys\.0\.depth_m is not a known key"),
    ],
)
def test_bad_bodies_are_refused(value: str, problem: str) -> None:
    with pytest.raises(ProfileError, match=problem):
        load_profile("sitl", [value]).runnable()


def test_a_buoy_is_refused_with_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        "extends: sitl\nworld:\n  buoys:\n    - {pos_ned_m: [0, 0]}\n    - {pos_ned_m: [5, 0], shape: ball}\n"
    )
    with pytest.raises(ProfileError, match=r"own\.yaml:5: world\.buoys\.1\.shape = 'ball' is not one of the choices"):
        load_profile(str(file)).runnable()


@pytest.mark.parametrize(
    ("detector", "problem"),
    [
        ("{kind: onnx, model: pyproject.toml}", r"cameras\.0\.detector of kind onnx needs 'classes'; add it"),
        ("{kind: onnx, model: nowhere.onnx, classes: [buoy]}", r"detector\.model: .*nowhere\.onnx does not exist"),
        ("{kind: colour, classes: [buoy]}", r"detector\.classes is for kind: onnx, and this detector is kind: colour"),
        ("{kind: onnx, model: pyproject.toml, classes: [buoy], overlap: 2}", r"overlap = 2 is too large"),
        ("7", r"detector = 7 is not a group"),
    ],
)
def test_a_bad_detector_is_refused(detector: str, problem: str) -> None:
    with pytest.raises(ProfileError, match=problem):
        load_profile("sitl-camera", [f"sensors.cameras.0.detector={detector}"]).runnable()


def test_the_name_of_a_detector_is_its_kind() -> None:
    short, long = (
        load_profile("sitl-camera", [f"sensors.cameras.0.detector={value}"]).runnable().sensors
        for value in ("colour", "{kind: colour}")
    )
    assert short == long


@pytest.mark.medium
def test_nothing_is_put_on_land_by_hand() -> None:
    profile = load_profile("sitl-perception").runnable()
    simulation, state = build_simulation(profile, Seeds(1))
    river = river_from_profile(profile, Seeds(1), Plant(simulation, state, default_rng(1)), lambda: Progress(""))
    assert river.encounters.afloat(*profile.mission.waypoints_ned_m[0])
    boom = profile.world.log_boom
    assert boom is not None
    assert boom.anchors_ne_m is not None
    assert not river.encounters.afloat(*boom.anchors_ne_m[1])  # in a pile
    bed = simulation.waterway.bed
    assert bed is not None
    # Far enough across the channel is a bank that is above the water: both sides of a line through the origin find one.
    across = [np.array([[step * 40.0, -step * 40.0]]) for step in range(-10, 11)]
    dry = [place for place in across if bed.bed_down_m(place)[0] < 0.0]
    assert dry
    assert not any(river.encounters.afloat(*place[0]) for place in dry)
