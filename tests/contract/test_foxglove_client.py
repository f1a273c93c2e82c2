"""`--live foxglove` as Foxglove's own client library meets it: @foxglove/ws-protocol under Node."""

from __future__ import annotations

import json
import queue
import shutil
import subprocess
import threading
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.session import run

CLIENT = Path(__file__).parents[2] / "build/foxglove-client"


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("node") is None or not (CLIENT / "node_modules").is_dir(),
    reason=f"needs Node and: npm install --prefix {CLIENT} @foxglove/ws-protocol@0.8.0 ws@8",
)
def test_it_subscribes_calls_sets_and_publishes(tmp_path: Path) -> None:
    profile = load_profile("sitl", ["live.foxglove=true", "live.commands=true", "clock.duration_s=40.0"])
    told: queue.Queue[str] = queue.Queue()

    def sail() -> None:
        run(profile, tmp_path / "run", False, NoDisplay, operation=Operation(pace=1.0), tell=told.put)

    sailing = threading.Thread(target=sail)
    sailing.start()
    address = told.get(timeout=PATIENCE_S).split()[1]
    words = ["node", str(Path(__file__).with_name("foxglove_client.mjs")), address, str(CLIENT)]
    try:
        seen = json.loads(subprocess.run(words, stdout=subprocess.PIPE, timeout=PATIENCE_S, check=True).stdout)
    finally:
        sailing.join()
    assert seen["problems"] == []
    assert seen["encodings"]["/truth/state"] == "cdr ros2msg"
    assert seen["encodings"]["/scene"] == "protobuf protobuf"
    assert {"/truth/state", "/scene", "/tf", "/operator/action", "/truth/bodies"} <= seen["counts"].keys()
    assert [seen["answers"][number]["success"] for number in "1234"] == [True, False, True, True]
    assert "mean_mps = 999 is too large" in seen["answers"]["2"]["message"]
    assert seen["parameters"]["environment.wind.mean_mps"] == 6.5
