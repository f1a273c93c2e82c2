"""The software bill of materials, of made-up packages whose needs are known, and of xitl."""

from __future__ import annotations

import json
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools.write_sbom import MissingPackageError, bill_of_materials, normal_name

ROOT = Path(__file__).parents[2]


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A boat that needs a hull; with its extra, a sail, which needs a hull too, and one for another system."""
    needs = {
        "Boat": ("hull>=1", "Sail_Cloth[dyed]; extra == 'sailing'", "anchor; sys_platform == 'plan9'"),
        "hull": (),
        "sail.cloth": ("hull", "ink; extra == 'dyed'", "boat"),
        "ink": (),
    }
    licences = {
        "Boat": "License-Expression: MIT",
        "hull": "License: a licence",
        "ink": "Classifier: License :: OSI Approved :: BSD License",
    }
    for name, requirements in needs.items():
        info = tmp_path / f"{name.replace('.', '_')}-2.1.dist-info"
        info.mkdir()
        lines = [f"Metadata-Version: 2.4\nName: {name}\nVersion: 2.1", licences.get(name, "Summary: no licence")]
        lines += [f"Requires-Dist: {requirement}" for requirement in requirements]
        (info / "METADATA").write_text("\n".join(lines) + "\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures("packages")
def test_it_lists_what_is_needed_with_scope_licence_and_relations() -> None:
    bill = bill_of_materials("boat", ["sailing"])
    assert bill["metadata"]["component"]["purl"] == "pkg:pypi/boat@2.1"
    assert "timestamp" not in bill["metadata"]
    assert {entry["name"]: (entry["scope"], entry.get("licenses")) for entry in bill["components"]} == {
        "hull": ("required", [{"license": {"name": "a licence"}}]),
        "ink": ("optional", [{"license": {"name": "BSD License"}}]),
        "sail-cloth": ("optional", None),
    }
    assert {each["ref"].split("/")[1]: each["dependsOn"] for each in bill["dependencies"]} == {
        "boat@2.1": ["pkg:pypi/hull@2.1", "pkg:pypi/sail-cloth@2.1"],
        "hull@2.1": [],
        "ink@2.1": [],
        "sail-cloth@2.1": ["pkg:pypi/boat@2.1", "pkg:pypi/hull@2.1", "pkg:pypi/ink@2.1"],
    }
    assert [entry["name"] for entry in bill_of_materials("boat", [])["components"]] == ["hull"]


@pytest.mark.usefixtures("packages")
def test_it_is_the_same_twice_and_dated_when_a_date_is_stated() -> None:
    first, again = (json.dumps(bill_of_materials("boat", ["sailing"])) for _ in range(2))
    assert first == again
    other = bill_of_materials("boat", [], stamp_s=1_700_000_000)
    assert other["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    assert other["serialNumber"] != json.loads(first)["serialNumber"]


def test_a_package_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "raft-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: raft\nVersion: 1\nRequires-Dist: drift-wood\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(MissingPackageError, match="drift-wood is not installed"):
        bill_of_materials("raft", [])


@pytest.mark.medium
def test_the_bill_of_xitl_has_its_own_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = {normal_name(line.split(">=")[0]) for line in project["dependencies"]}
    listed = {entry["name"] for entry in bill_of_materials("xitl", [])["components"]}
    assert wanted <= listed


@pytest.mark.medium
@pytest.mark.skipif(find_spec("jsonschema") is None or find_spec("cyclonedx") is None, reason="needs xitl[test]")
def test_the_bill_of_xitl_conforms_to_the_published_schema() -> None:
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    text = json.dumps(bill_of_materials("xitl", ["view"], stamp_s=0))
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    broken = text.replace('"specVersion": "1.6"', '"specVersion": 1.6')
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(broken) is not None
