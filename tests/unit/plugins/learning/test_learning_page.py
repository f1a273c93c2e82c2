"""The page on learning environments and the example that trains, against the code."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng

from agent.fcu.parameters import Parameters
from xitl_cli.plugins.learning.observation import PARTS

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs/learning.md").read_text(encoding="utf-8")


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_lists_every_part_of_an_observation_with_its_limit() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([\w.π]+) \|$", PAGE, re.MULTILINE)
    limits = {"none": np.inf, "π": np.pi}
    listed = {name: (numbers, limits.get(limit) or float(limit)) for name, numbers, limit in rows}
    assert listed == {name: (part.numbers, part.limit) for name, part in PARTS.items()}


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """The controller beside other weights, as after a training."""
    shutil.copy(ROOT / "examples/learned_heading.py", tmp_path)
    return tmp_path


def test_the_controller_computes_the_network_that_was_trained(copied: Path) -> None:
    training = loaded(ROOT / "examples/learn_heading.py")
    weights = default_rng(2).standard_normal(training.HIDDEN * (training.FEATURES + 1))
    training.write(copied / "learned_heading.json", weights)
    controller = loaded(copied / "learned_heading.py").LearnedHeading(Parameters({}))
    inputs = default_rng(3).uniform(-1.0, 1.0, (7, 4))
    batch = training.steering(weights[None], inputs[None])[0]
    assert [controller.steering(tuple(row)) for row in inputs.tolist()] == pytest.approx(batch.tolist())


def test_training_and_controller_allocate_alike() -> None:
    from agent.fcu.control.allocation import Allocation, AllocationGains, allocate

    training = loaded(ROOT / "examples/learn_heading.py")
    gains = AllocationGains(astern=0.6, expo=1.0, slew_per_s=0.0)
    demands = default_rng(4).uniform(-1.2, 1.2, (200, 2))
    wanted = [allocate(gains, Allocation(), thrust, steer, 0.02).command for thrust, steer in demands.tolist()]
    assert training.commands(*demands.T) == pytest.approx(np.array(wanted), abs=1e-9)


@pytest.mark.nightly
@pytest.mark.slow
def test_training_improves_the_network(copied: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """A small one: fewer networks, boats and seconds."""
    pytest.importorskip("gymnasium")
    training = loaded(ROOT / "examples/learn_heading.py")
    for name, value in (("PAIRS", 24), ("BOATS_EACH", 2), ("EPISODE_S", 6.0)):
        monkeypatch.setattr(training, name, value)
    out = copied / "learned_heading.json"
    monkeypatch.setattr("sys.argv", ["learn_heading.py", "--generations", "8", "--out", str(out)])
    training.main()
    rewards = [float(text) for text in re.findall(r"mean reward\s+(-\d\.\d+)", capsys.readouterr().out)]
    assert len(rewards) == 8
    assert max(rewards[4:]) > rewards[0]
    assert set(json.loads(out.read_text())) == {"hidden", "output"}
    loaded(copied / "learned_heading.py").LearnedHeading(Parameters({}))
