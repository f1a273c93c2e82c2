"""What is advised of figures that differ from their references."""

from __future__ import annotations

import re

import pytest

from sim_core.vessel.spec import VesselSpec
from xitl_cli.logs.model.sections import Fact, Section
from xitl_cli.plugins.studies.manoeuvres import validation
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, ReferenceKind, Source
from xitl_cli.plugins.studies.manoeuvres.validation import ValidatedFigure, Validation
from xitl_cli.plugins.studies.manoeuvres.validation_page import advice, shares, validation_page

SOURCES = {
    validation.ARCHIMEDES: "vehicle.mass_kg",
    validation.SURGE_ALONE: "vehicle.propellers.N.position_frd_m",
    validation.HORIZONTAL: "vehicle.centre_of_gravity_frd_m",
    validation.MIRRORED: "propellers and rudders",
    validation.LINEAR: "vehicle.damping_quadratic",
    validation.STRIPS: "vehicle.damping_linear",
    validation.PANEL_CODE: "vehicle.hydrodynamics_file",
    validation.LONG_WAVES: "vehicle.inertia_kgm2",
    validation.LOITER: "LOIT_RADIUS",
    Source(ReferenceKind.PUBLISHED, "Fossen 2021"): "vehicle.name",
}


def figure(value: float | None, source: Source, at_most: bool = False) -> ValidatedFigure:
    reference = FigureReference(10.0, 0.5, source, at_most=at_most)
    return ValidatedFigure("Free decays", "roll_period_s", "roll, natural period", "s", value, reference)


@pytest.mark.parametrize("source", SOURCES)
def test_each_difference_has_a_key_to_change_and_its_weight(source: Source) -> None:
    assert advice(figure(10.4, source)) == ""
    near, far, never = (advice(figure(value, source)) for value in (11.0, 15.0, None))
    assert near.startswith("It hardly matters: the error is 2 times its tolerance, and ")
    assert far.startswith("It matters: the error is 10 times its tolerance, and ")
    assert never.startswith("It matters: the manoeuvre never reached it. To change it, ")
    assert all(SOURCES[source] in text for text in (near, far, never))


def test_keys_that_are_named_exist() -> None:
    fields = set(VesselSpec.__dataclass_fields__) | {"name"}
    for source in SOURCES:
        for key in re.findall(r"vehicle\.(\w+)", advice(figure(15.0, source))):
            assert key in fields


def test_the_page_has_the_advice_as_the_next_step() -> None:
    off = figure(11.0, validation.LINEAR)
    section = Section("decays", "Free decays", (Fact(off.key, off.label, off.value, off.unit),))
    page = validation_page([Validation("boat", "rudder", (section,), (off,))])
    (found,) = page.parts[0].section.findings
    assert found.next_step == advice(off)


def test_the_shares_count_each_comparison_once() -> None:
    sources = (*SOURCES, Source(ReferenceKind.MEASURED, "a tank"))
    figures = tuple(figure(10.0, source) for source in sources)
    unknown = ValidatedFigure("Free decays", "roll_period_s", "roll, natural period", "s", 1.0, None)
    found = dict(shares([Validation("boat", "rudder", (), (*figures, unknown))]))
    assert found == {
        "measured": "1 of 11 (9 %)",
        "published": "1 of 11 (9 %)",
        "panel code": "1 of 11 (9 %)",
        "closed form": "3 of 11 (27 %)",
        "same equations": "5 of 11 (45 %)",
        "from outside xitl": "3 of 11 (27 %)",
    }
