"""@SYS/tasks.txt: of a real autopilot, and what a file must not do to its reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_log import MadeLog, MadeTable

from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.logs.model.system_files import TaskTime, parse_tasks, tasks_counted
from xitl_cli.params.vehicle import VehicleFiles
from xitl_cli.plugins.logs.analyses.tasks import analyse
from xitl_cli.plugins.logs.command import read_tasks

CAPTURED = Path(__file__).parents[2] / "data/captures/linux-tasks.txt"
IDLE = "AP_GyroFFT::sample_gyros*        MIN=   0 MAX=   0 AVG=   0 OVR=  0 SLP=  0, TOT= 0.0%\n"
LATE = "GCS::update_send                 MIN=  12 MAX=9999 AVG=  40 OVR=  7 SLP=  0, TOT=61.5%\n"


def test_a_real_file_is_read_to_the_last_task() -> None:
    text = CAPTURED.read_text()
    tasks = parse_tasks(text)
    assert len(tasks) == len(text.splitlines()) - 1  # all but the header
    assert tasks_counted(tasks)
    by_name = {task.name: task for task in tasks}
    assert by_name["Rover::ahrs_update"] == TaskTime("Rover::ahrs_update", False, 70, 218, 100, 0, 57.5)
    assert sum(task.share_percent for task in tasks) == pytest.approx(100.0, abs=0.05 * len(tasks))  # each rounded


def test_fast_tasks_and_a_simulator_that_counts_nothing() -> None:
    (task,) = parse_tasks("TasksV2\n" + IDLE)
    assert (task.name, task.fast) == ("AP_GyroFFT::sample_gyros", True)
    assert not tasks_counted([task])


@pytest.mark.medium
@settings(max_examples=30, deadline=None)
@given(st.text(max_size=300))
def test_whatever_it_holds_is_no_error(text: str) -> None:
    for task in parse_tasks(f"TasksV2\n{text}\n{LATE}{text}"):
        assert task.most_us >= 0


def test_beside_the_log_it_is_found_and_overruns_are_told(tmp_path: Path) -> None:
    log = MadeLog(MadeTable("PM", [1], {"NLon": [0]}), path=str(tmp_path / "log.bin"))
    section = analyse(log)
    assert section is not None
    assert "xitl logs tasks" in section.lacks[0]
    (tmp_path / "log.bin.tasks.txt").write_text("TasksV2\n" + IDLE + LATE)
    section = analyse(log)
    assert section is not None
    (finding,) = section.findings
    assert finding.key == "tasks.overruns"
    assert "GCS::update_send 7" in finding.sentence
    (grid,) = section.grids
    assert grid.rows == (("GCS::update_send", "", 61.5, 40, "9999 or more", 12, 7),)


class _Vehicle:
    """Serves one file as ArduPilot does: a size that is not its own, its end as an error."""

    target = (1, 1)

    def __init__(self, *answers: bytes) -> None:
        self._answers = list(answers)
        self._content = b""
        self._waiting: list[Any] = []
        self.closed = 0

    def send(self, message: Any) -> bool:
        payload = bytes(message.payload)
        sequence, session, operation, size = int.from_bytes(payload[:2], "little"), payload[2], payload[3], payload[4]
        offset = int.from_bytes(payload[8:12], "little")
        data, kind = b"", 128
        if operation == 4:
            assert payload[12 : 12 + size] == b"@SYS/tasks.txt"
            self._content = self._answers.pop(0)
            data = (100_000).to_bytes(4, "little")
        elif operation == 5:
            data = self._content[offset : offset + size]
            if not data:
                data, kind = bytes([6]), 129
        else:
            self.closed += operation == 1
        head = ((sequence + 1) & 0xFFFF).to_bytes(2, "little") + bytes([session, kind, len(data), operation, 0, 0])
        answer = (head + payload[8:12] + data).ljust(251, b"\0")
        self._waiting.append(dialect.MAVLink_file_transfer_protocol_message(0, 254, 191, answer))
        return True

    def receive(self, timeout_s: float) -> list[Any]:
        waiting, self._waiting = self._waiting, []
        return waiting


def test_fetching_waits_until_something_is_counted() -> None:
    whole = CAPTURED.read_bytes()
    vehicle = _Vehicle(b"TasksV2\n", b"TasksV2\n", whole)
    assert read_tasks(VehicleFiles(vehicle), "udp://it", again_s=0.0) == whole.decode()  # type: ignore[arg-type]
    assert vehicle.closed == 3


def test_a_vehicle_that_never_counts_is_a_sentence() -> None:
    vehicle = _Vehicle(*[b"TasksV2\n"] * 20)
    with pytest.raises(UserError, match="SCHED_OPTIONS"):
        read_tasks(VehicleFiles(vehicle), "udp://it", again_s=0.0)  # type: ignore[arg-type]
