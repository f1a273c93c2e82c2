"""Files of an installed agent: what is written where, and what is said when it cannot be."""

from __future__ import annotations

import errno
import io
import json
import zipfile
from pathlib import Path
from typing import NoReturn

import pytest

from agent.board.install import (
    ARCHIVE,
    DeploySettings,
    DeploySettingsError,
    InstallError,
    install,
    install_places,
    settings_from_json,
    settings_to_json,
)
from agent.board.service import ServiceError, quoted, unit_text
from tests.golden import Golden

NOTHING = DeploySettings(service=False, options=None, files={})


def archive(program: str = "print('xitl agent 1')") -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as opened:
        opened.writestr(zipfile.ZipInfo("__main__.py"), program)  # without the time of day
    return made.getvalue()


def test_a_second_time_changes_nothing(tmp_path: Path) -> None:
    where = install_places(True, tmp_path, str(tmp_path))
    settings = DeploySettings(
        False, {"link": ("udp://usb0:14660",), "gcs": ("udp://a:1", "udp://b:2")}, {"link-key": "k"}
    )
    first = install(archive(), settings, where)
    assert first["changed"] == ["/usr/local/bin/xitl-agent.pyz", "/etc/xitl/link.key", "/etc/xitl/agent.conf"]
    assert first["command"][1:] == ["/usr/local/bin/xitl-agent.pyz", "--config", "/etc/xitl/agent.conf"]
    assert install(archive(), settings, where)["changed"] == []
    assert install(archive("print('xitl agent 2')"), NOTHING, where)["changed"] == ["/usr/local/bin/xitl-agent.pyz"]
    assert (tmp_path / "etc/xitl/agent.conf").read_text().splitlines()[1:] == [
        "[agent]",
        "gcs = udp://a:1",
        "    udp://b:2",
        "link = udp://usb0:14660",
        "link-key = /etc/xitl/link.key",
    ]


def test_what_the_agent_reads_back_is_what_was_asked_for(tmp_path: Path) -> None:
    from agent.options import parse

    where = install_places(False, tmp_path)
    options = {"link": ("udp://127.0.0.1:1",), "gcs": ("udp://a:1", "tcp://b:2"), "realtime": ("40",), "cpu": ("0",)}
    files = {"link-key": "secret", "parameters": "CRUISE_SPEED 1"}
    outcome = install(archive(), DeploySettings(False, {**options, "log-dir": ("logs",)}, files), where)
    read = parse(outcome["command"][2:], "test")
    assert (read.link, read.ground, read.realtime, read.cpus) == (
        "udp://127.0.0.1:1",
        ("udp://a:1", "tcp://b:2"),
        40,
        (0,),
    )
    assert read.log_dir == tmp_path / ".local/state/xitl/logs"
    assert read.link_key is not None
    assert read.link_key.read_text() == "secret"


def test_one_that_does_not_start_leaves_the_old_one(tmp_path: Path) -> None:
    where = install_places(False, tmp_path)
    install(archive(), NOTHING, where)
    before = (where.programs / ARCHIVE).read_bytes()
    with pytest.raises(InstallError, match=r"does not start with Python .*no such thing.*unchanged"):
        install(archive("raise SystemExit('no such thing')"), NOTHING, where)
    assert (where.programs / ARCHIVE).read_bytes() == before
    assert [path.name for path in where.programs.iterdir()] == [ARCHIVE]


def test_a_full_disk_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    where = install_places(False, tmp_path)
    install(archive(), NOTHING, where)

    def full(descriptor: int) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("agent.board.install.os.fsync", full)
    with pytest.raises(InstallError) as refused:
        install(archive("print('2')"), NOTHING, where)
    golden("error", refused.value)
    assert [path.name for path in where.programs.iterdir()] == [ARCHIVE]


def test_settings_come_through_as_they_were() -> None:
    settings = DeploySettings(True, {"link": ("udp://a:1",), "gcs": ("b", "c")}, {"signing-key": "x"})
    assert settings_from_json(settings_to_json(settings)) == settings
    assert settings_from_json(settings_to_json(NOTHING)) == NOTHING


@pytest.mark.parametrize(
    "given",
    [
        b"",
        b"[]",
        b"{}",
        b'{"service": 1, "options": {}, "files": {}}',
        json.dumps({"service": True, "options": {"Link": ["x"]}, "files": {}}).encode(),
        json.dumps({"service": True, "options": {"link": "x"}, "files": {}}).encode(),
        json.dumps({"service": True, "options": {"link": ["x\n[other]"]}, "files": {}}).encode(),
        json.dumps({"service": True, "options": {"link": [" x"]}, "files": {}}).encode(),
        json.dumps({"service": True, "options": {}, "files": {"../x": "y"}}).encode(),
        json.dumps({"service": True, "options": {}, "files": {"link-key": 1}}).encode(),
        json.dumps({"service": True, "options": {}, "files": {"link-key": "x" * 2_000_000}}).encode(),
    ],
)
def test_settings_that_cannot_be_are_refused(given: bytes) -> None:
    with pytest.raises(DeploySettingsError):
        settings_from_json(given)


def test_words_of_a_unit_are_taken_literally() -> None:
    # systemd.service(5): "%" and "$" are doubled, backslash and quote are escaped within quotes
    assert quoted('/home/a b/%n/$X/"\\') == '"/home/a b/%%n/$$X/\\"\\\\"'
    with pytest.raises(ServiceError, match="control characters"):
        quoted("/home/a\nExecStartPre=b")


def test_a_units_kind() -> None:
    system, user = (unit_text(["/usr/bin/python3"], "/var/lib/xitl", system=kind) for kind in (True, False))
    assert "WantedBy=multi-user.target" in system
    assert "WantedBy=default.target" in user
    assert "CapabilityBoundingSet" not in user  # a user's manager may not set it
    for text in (system, user):
        assert {"Type=notify", "LimitMEMLOCK=infinity", "LimitRTPRIO=99", "NoNewPrivileges=yes"} <= set(
            text.splitlines()
        )
