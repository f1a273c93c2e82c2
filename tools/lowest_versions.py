"""Print constraints that pin each direct dependency of xitl to the lowest version that pyproject.toml permits.

`make test-lowest` installs with them. An extra in the arguments adds the dependencies of that extra.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(\[[^]]*\])?\s*>=(?P<lowest>[\w.]+)")


def lowest_versions(extras: list[str]) -> Iterator[str]:
    """Yield a line for each dependency. Raises KeyError for an unknown extra, ValueError without a lower end."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    requirements = list(project["dependencies"])
    for extra in extras:
        requirements += project["optional-dependencies"][extra]
    for requirement in sorted(set(requirements), key=str.lower):
        match = _REQUIREMENT.match(requirement)
        if match is None:
            raise ValueError(f"pyproject.toml: {requirement!r} has no lower end; write it like numpy>=2.0")
        yield f"{match['name']}=={match['lowest']}"


if __name__ == "__main__":
    sys.stdout.write("".join(f"{line}\n" for line in lowest_versions(sys.argv[1:])))
