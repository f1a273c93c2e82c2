"""Write the software bill of materials of xitl as CycloneDX JSON: the packages that it and its extras need.

It describes the installed versions. The same versions give the same bytes. A package that every installation has is
`required`; a package that only an extra brings is `optional`. Format: https://cyclonedx.org/docs/1.6/json/
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import uuid
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

_NAMESPACE = uuid.UUID("6ba7b811-9dad-11d1-80b4-00c04fd430c8")  # of URLs, RFC 4122 appendix C
_LONGEST_LICENCE = 60  # characters; longer ones are whole texts


class MissingPackageError(Exception):
    """A needed package is not installed."""


def normal_name(name: str) -> str:
    """Return a package's name as an index spells it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed_by(package: Distribution, extras: Iterable[str]) -> list[Requirement]:
    """Return the requirements of a package with these extras, on this system."""
    wanted = [Requirement(text) for text in package.requires or ()]
    environments = [{"extra": extra} for extra in ("", *extras)]
    return [each for each in wanted if each.marker is None or any(map(each.marker.evaluate, environments))]


def installed_closure(root: str, extras: Iterable[str] = ()) -> dict[str, tuple[Distribution, set[str]]]:
    """Return each package that `root` with these extras needs, itself first, with the names of those it needs itself.

    Raises MissingPackageError.
    """
    found: dict[str, tuple[Distribution, set[str]]] = {}
    asked: dict[str, set[str]] = {}
    left = [(normal_name(root), frozenset(extras))]
    while left:
        name, more = left.pop()
        if name in asked and more <= asked[name]:
            continue
        asked.setdefault(name, set()).update(more)
        try:
            package = distribution(name)
        except PackageNotFoundError:
            raise MissingPackageError(f"{name} is not installed; run pip install 'xitl[all]'") from None
        needs = needed_by(package, asked[name])
        found[name] = package, {normal_name(each.name) for each in needs} - {name}
        left += [(normal_name(each.name), frozenset(each.extras)) for each in needs]
    return found


def licence_of(package: Distribution) -> list[dict[str, Any]]:
    """Return the licence as the package states it: an SPDX expression, a name, or nothing."""
    keys = ("License-Expression", "License")
    expression, stated = ((package.metadata.get_all(key) or [""])[0] for key in keys)
    if expression:
        return [{"expression": expression}]
    names = [
        text.rpartition(" :: ")[2]
        for text in package.metadata.get_all("Classifier") or ()
        if text.startswith("License :: ") and not text.endswith("OSI Approved")
    ]
    if not names and stated and "\n" not in stated and len(stated) <= _LONGEST_LICENCE:
        names = [stated]
    return [{"license": {"name": name}} for name in names]


def component(package: Distribution, scope: str) -> dict[str, Any]:
    """Return the entry of a package."""
    name = normal_name(package.metadata["Name"])
    purl = f"pkg:pypi/{name}@{package.version}"
    entry = {"type": "library", "bom-ref": purl, "name": name, "version": package.version, "scope": scope, "purl": purl}
    licences = licence_of(package)
    return {**entry, "licenses": licences} if licences else entry


def bill_of_materials(root: str, extras: Iterable[str], stamp_s: int | None = None) -> dict[str, Any]:
    """Return the document. stamp_s: time in seconds since 1970, left out when None. Raises MissingPackageError."""
    everything, base = installed_closure(root, extras), installed_closure(root)
    components = {
        name: component(package, "required" if name in base else "optional")
        for name, (package, _) in sorted(everything.items())
    }
    references = {name: entry["bom-ref"] for name, entry in components.items()}
    whole = {key: value for key, value in components.pop(normal_name(root)).items() if key != "scope"}
    content = {
        "components": list(components.values()),
        "dependencies": [
            {"ref": references[name], "dependsOn": sorted(references[other] for other in needs)}
            for name, (_, needs) in sorted(everything.items())
        ],
    }
    metadata: dict[str, Any] = {"component": {**whole, "type": "application"}}
    if stamp_s is not None:
        metadata["timestamp"] = datetime.fromtimestamp(stamp_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(_NAMESPACE, json.dumps([whole, content], sort_keys=True))}",
        "version": 1,
        "metadata": metadata,
        **content,
    }


def main() -> None:
    """Write the document to the file in the arguments."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--extras", default="all", help="extras of xitl, separated by commas")
    options = parser.parse_args()
    stamp = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        document = bill_of_materials(
            "xitl", filter(None, options.extras.split(",")), None if stamp is None else int(stamp)
        )
    except MissingPackageError as error:
        sys.exit(f"error: {error}")
    options.file.parent.mkdir(parents=True, exist_ok=True)
    options.file.write_text(json.dumps(document, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    print(f"{options.file}: {len(document['components'])} packages")


if __name__ == "__main__":
    main()
