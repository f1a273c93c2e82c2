from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from typer.testing import CliRunner

from xitl_cli.errors import UserError


@dataclass(frozen=True)
class Ran:
    """How a command ended. `error` is the line that `xitl` prints before it exits with 2."""

    code: int
    out: str
    error: str

    @property
    def told(self) -> Any:
        return json.loads(self.out)


Params = Callable[..., Ran]


@pytest.fixture
def params() -> Params:
    """`xitl params ARGUMENTS`, in this process."""
    from tests.command_line import xitl_app

    def run(*arguments: str) -> Ran:
        result = CliRunner().invoke(xitl_app(), ["params", *arguments])
        if isinstance(result.exception, UserError):
            return Ran(2, result.stdout, str(result.exception))
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return Ran(result.exit_code, result.stdout, "")

    return run


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether others would be heard is not waited for."""
    monkeypatch.setattr("xitl_cli.params.vehicle.OTHERS_S", 0.0)
