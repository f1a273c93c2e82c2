"""Packages with entry points, as if they were installed: a folder on the path with code and a dist-info folder."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from xitl_cli import registry

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a package with one module and these entry points, `group` to `name = target`."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    modules: list[str] = []

    def forget() -> None:
        for found in vars(registry).values():
            if hasattr(found, "cache_clear"):
                found.cache_clear()

    def made(package: str, code: str, **entries: str) -> None:
        module = package.replace("-", "_")
        modules.append(module)
        (site / f"{module}.py").write_text(code, encoding="utf-8")
        info = site / f"{module}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n", encoding="utf-8")
        groups = "\n".join(f"[xitl.{group}]\n{entry}" for group, entry in entries.items())
        (info / "entry_points.txt").write_text(groups + "\n", encoding="utf-8")
        forget()

    forget()
    yield made
    forget()
    for module in modules:
        sys.modules.pop(module, None)
