"""Tests of the compiled step need its kernel."""

from __future__ import annotations

import pytest

from sim_core.tape.library import NoKernelError, load_kernel


def why_no_kernel() -> str:
    """Return why this machine has no kernel, empty if it has one."""
    try:
        load_kernel()
    except NoKernelError as error:
        return str(error)
    return ""


needs_kernel = pytest.mark.skipif(bool(why_no_kernel()), reason=why_no_kernel() or "has one")
