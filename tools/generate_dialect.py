"""Generate agent/wire/dialect.py from agent/wire/xitl.xml with mavgen; `--check` says whether it is current.

mavgen's output brings a checksum that is slow without a compiled package; that one block is replaced by
`agent.wire.crc`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
from pathlib import Path

from pymavlink.generator import mavgen

CHECKSUM = re.compile(r"^# CRC calculation using fastcrc.*?^x25crc = [^\n]*\n", flags=re.M | re.S)
WIRE = Path(__file__).resolve().parent.parent / "agent" / "wire"


def generated(definition: Path) -> str:
    """Python source of the codec for one dialect file."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "dialect.py"
        options = mavgen.Opts(str(output), wire_protocol="2.0", language="Python3", validate=True, strict_units=True)
        with contextlib.redirect_stdout(io.StringIO()) as report:
            ok = mavgen.mavgen(options, [str(definition)])
        if not ok or not output.exists():
            raise SystemExit(f"{definition}: mavgen refused it:\n{report.getvalue()}")
        source = output.read_text()
    source, replaced = CHECKSUM.subn("from agent.wire.crc import x25crc\n", source)
    if replaced != 1:
        raise SystemExit("mavgen writes its checksum in a new way: adapt tools/generate_dialect.py")
    return source


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--check", action="store_true", help="write nothing; exit 1 when dialect.py is not current")
    check = arguments.parse_args().check
    target, source = WIRE / "dialect.py", generated(WIRE / "xitl.xml")
    if target.exists() and target.read_text() == source:
        print(f"{target.name} is current")
    elif check:
        sys.exit(f"{target} does not match xitl.xml: run `make dialect`")
    else:
        target.write_text(source)
        print(f"wrote {target}")


if __name__ == "__main__":
    main()
