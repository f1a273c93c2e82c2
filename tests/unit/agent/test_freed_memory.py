"""The memory that a companion freed returns to the system."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("numpy")
ROOT = Path(__file__).parents[3]
MEASURE = """
import re
import numpy as np
import agent.node
from agent.__main__ import main

def anonymous_kib():
    return int(re.search(r"^Anonymous: +(\\d+)", open("/proc/self/smaps_rollup").read(), re.MULTILINE)[1])

def measure(node, keep_on):
    np.ones(1 << 21)  # 16 MB: glibc raises its limits when they are freed
    before_kib = anonymous_kib()
    working = [np.ones(1 << 16) for _ in range(40)]  # 20 MB
    most_kib = anonymous_kib()
    working.clear()
    print(most_kib - before_kib, anonymous_kib() - before_kib)

agent.node.AgentNode.serve = measure
main(["--role", "companion", "--link", "udp://127.0.0.1:0"])
"""


@pytest.mark.medium
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs Linux with glibc")
def test_the_working_memory_of_a_companion_does_not_stay_in_its_heap() -> None:
    done = subprocess.run([sys.executable, "-c", MEASURE], cwd=ROOT, capture_output=True, text=True, check=True)
    working_kib, kept_kib = map(int, done.stdout.splitlines()[-1].split())
    assert working_kib > 4000
    assert kept_kib < 200
