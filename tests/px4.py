"""A real PX4 for tests marked `px4`."""

from __future__ import annotations

from pathlib import Path

import pytest

from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import PX4_VARIABLE, find_px4


def px4_program() -> Path:
    """Named by XITL_PX4 or on the PATH; the test is skipped when there is none."""
    try:
        return find_px4()[0]
    except UserError as error:
        pytest.skip(f"needs a real PX4 ({PX4_VARIABLE}=PATH): {error}")
