"""MAVLink FTP against a vehicle by pymavlink's codec, on lines that lose, and what can go wrong with a file.

The same client brings a file to a real Rover in test_hil_rover.py.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from agent.mavlink import ftp
from agent.mavlink.ftp import FtpRefusedError, checksum, has_folder, read_checksum, write_file
from tests.doubles.ftp_vehicle import FtpVehicle, crc32, listening
from xitl_cli.errors import UserError
from xitl_cli.params.vehicle import VehicleFiles, connect
from xitl_cli.plugins.params.push import install_script

CONTENT = bytes(random.Random(3).randbytes(2000))


@pytest.fixture(autouse=True)
def _patient_for_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ftp, "ANSWER_S", 0.06)


@contextmanager
def client(vehicle: FtpVehicle) -> Iterator[Any]:
    with listening(vehicle) as url, connect(url) as reached:
        yield reached


@pytest.mark.parametrize("content", [b"", b"a", b"123456789", bytes(range(256)) * 3])
def test_the_checksum_is_that_of_the_protocol(content: bytes) -> None:
    assert checksum(content) == crc32(content)


@pytest.mark.parametrize("lose", [0, 5, 7])
def test_a_file_arrives_whole_though_messages_are_lost(lose: int) -> None:
    vehicle = FtpVehicle(folders={"/scripts"}, lose=lose)
    with client(vehicle) as reached:
        files = VehicleFiles(reached)
        heard: list[float] = []
        files.run(write_file("scripts/a.lua", CONTENT, heard.append))
        assert files.run(read_checksum("scripts/a.lua")) == checksum(CONTENT)
        assert files.run(read_checksum("scripts/b.lua")) is None
    assert vehicle.files == {"/scripts/a.lua": CONTENT}
    assert vehicle.done.count(ftp.WRITE) == -(-len(CONTENT) // ftp.DATA_BYTES)  # a repetition is not done twice
    assert vehicle.done.count(ftp.TERMINATE) == 1
    assert heard == sorted(heard)
    assert heard[-1] == 1.0


def test_the_script_goes_where_the_vehicle_keeps_its_scripts() -> None:
    board, plain = FtpVehicle(folders={"/APM"}), FtpVehicle()
    for vehicle, path in ((board, "/APM/scripts/xitl_hil.lua"), (plain, "/scripts/xitl_hil.lua")):
        with client(vehicle) as reached:
            where, written = install_script(reached, CONTENT)
            assert written
            assert f"/{where.lstrip('/')}" == path
            assert vehicle.files == {path: CONTENT}
            assert install_script(reached, CONTENT) == (where, False)
            assert install_script(reached, CONTENT + b"new") == (where, True)
        assert vehicle.done.count(ftp.CREATE) == 2


def test_a_vehicle_whose_files_another_client_has_is_asked_again() -> None:
    vehicle = FtpVehicle(folders={"/scripts"}, busy=2)
    with client(vehicle) as reached:
        assert VehicleFiles(reached).run(read_checksum("scripts/a.lua")) is None


def test_another_client_that_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ftp, "BUSY_S", 0.15)
    with (
        client(FtpVehicle(busy=10_000)) as reached,
        pytest.raises(FtpRefusedError, match="another client uses its files"),
    ):
        VehicleFiles(reached).run(read_checksum("scripts/a.lua"))
    with (
        client(FtpVehicle(busy=10_000)) as reached,
        pytest.raises(UserError, match="cannot be installed on the vehicle: another client uses its files"),
    ):
        install_script(reached, CONTENT)


def test_an_answer_that_comes_late_is_not_taken_for_the_next() -> None:
    vehicle = FtpVehicle(folders={"/scripts"}, files={"/scripts/a.lua": b"a"}, late=True)
    with client(vehicle) as reached:
        files = VehicleFiles(reached)
        assert files.run(read_checksum("scripts/a.lua")) == checksum(b"a")
        files.run(write_file("scripts/b.lua", CONTENT))
        assert files.run(read_checksum("scripts/b.lua")) == checksum(CONTENT)
        assert files.run(read_checksum("scripts/a.lua")) == checksum(b"a")


def test_a_folder_may_be_empty() -> None:
    with client(FtpVehicle(folders={"/APM"})) as reached:
        files = VehicleFiles(reached)
        assert (files.run(has_folder("/APM")), files.run(has_folder("/elsewhere"))) == (True, False)


def test_what_goes_wrong_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for vehicle, words in (
        (FtpVehicle(no_card=True), r"its file system fails \(error 30\); check that it has a memory card"),
        (FtpVehicle(spoil=True), "is damaged on the vehicle"),
    ):
        with client(vehicle) as reached, pytest.raises(UserError, match=words):
            install_script(reached, CONTENT)
    monkeypatch.setattr(ftp, "TRIES", 2)
    with client(FtpVehicle(deaf=True)) as reached, pytest.raises(UserError, match="does not answer MAVLink FTP"):
        install_script(reached, CONTENT)
