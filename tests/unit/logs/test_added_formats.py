"""Log formats of other packages: used where no format of xitl recognises the file, and named when they fail."""

from __future__ import annotations

from pathlib import Path

import pytest
from dataflash_records import ITSELF, described, record

from tests.installed_packages import Install
from xitl_cli.logs import LogError, open_log

WRAPPED = """
from xitl_cli.logs.formats.added import LogFormat
from xitl_cli.logs.formats.dataflash.file import DataFlashLog

def opened(path):
    inner = path.with_suffix(".inner")
    inner.write_bytes(bytes(255 - byte for byte in path.read_bytes()[4:]))
    return DataFlashLog(inner)

FORMAT = LogFormat(lambda head: head.startswith(b"VEND"), opened)
BROKEN = LogFormat(lambda head: head.startswith(b"VEND"), lambda path: 1 / 0)
"""


@pytest.fixture
def vendor_log(tmp_path: Path) -> Path:
    path = tmp_path / "boat.vend"
    rows = b"".join(record(131, "Qf", 1000 * number, 0.5 * number) for number in range(100))
    log = ITSELF + described(131, b"BOAT", "Qf", "TimeUS,Speed") + rows
    path.write_bytes(b"VEND" + bytes(255 - byte for byte in log))
    return path


def test_a_format_of_a_package_opens_its_files(install: Install, vendor_log: Path) -> None:
    with pytest.raises(LogError, match="is not a log"):
        open_log(vendor_log)
    install("xitl-vendor", WRAPPED, log_formats="vendor = xitl_vendor:FORMAT")
    with open_log(vendor_log) as log:
        assert log.tables["BOAT"].values("Speed")[-1] == 49.5


def test_a_format_that_fails_is_named(install: Install, vendor_log: Path) -> None:
    install("xitl-vendor", WRAPPED, log_formats="vendor = xitl_vendor:BROKEN")
    with pytest.raises(LogError, match=r"the log format vendor failed to open it \(ZeroDivisionError: "):
        open_log(vendor_log)


def test_a_format_that_cannot_be_loaded_is_left_out(install: Install, vendor_log: Path) -> None:
    install("xitl-vendor", "raise RuntimeError", log_formats="vendor = xitl_vendor:FORMAT")
    with pytest.raises(LogError, match="is not a log"):
        open_log(vendor_log)
