"""Generate agent/wire/dialect.py from agent/wire/fleet.xml with mavgen; `--check` says whether it is current.

Three things are changed in mavgen's output, for a slow board's sake. Its checksum is slow without a compiled
package: `agent.wire.crc` takes its place. Its methods that make and send a message are left out: the link does that,
and they are half of what is loaded. Its annotations stay text. What it does not tell is added: how much of a payload
MAVLink 1 has.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
from pathlib import Path

from pymavlink.generator import mavgen, mavparse

CHECKSUM = re.compile(r"^# CRC calculation using fastcrc.*?^x25crc = [^\n]*\n", flags=re.M | re.S)
SENDERS = re.compile(r"^    def \w+_(?:encode|send)\(self, .*?(?=^    def |\Z)", flags=re.M | re.S)
IMPORTS = re.compile(r"^import hashlib$", flags=re.M)
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
    source, removed = SENDERS.subn("", source)
    source, marked = IMPORTS.subn("from __future__ import annotations\n\nimport hashlib", source)
    if removed < 2 or marked != 1:
        raise SystemExit("mavgen writes its methods in a new way: adapt tools/generate_dialect.py")
    parsed = [mavparse.MAVXML(str(file), "2.0") for file in _with_included(definition)]
    messages = [message for xml in parsed for message in xml.message]
    shorter = {message.id: message.wire_min_length for message in messages if message.extensions_start is not None}
    return f"{source}\n\nMAVLINK1_PAYLOAD_BYTES = {dict(sorted(shorter.items()))}  # of messages with extensions\n"


def _with_included(definition: Path) -> list[Path]:
    included = re.findall(r"<include>(.*?)</include>", definition.read_text())
    return [definition, *(definition.parent / name for name in included)]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--check", action="store_true", help="write nothing; exit 1 when dialect.py is not current")
    check = arguments.parse_args().check
    target, source = WIRE / "dialect.py", generated(WIRE / "fleet.xml")
    if target.exists() and target.read_text() == source:
        print(f"{target.name} is current")
    elif check:
        sys.exit(f"{target} does not match fleet.xml and xitl.xml: run `make dialect`")
    else:
        target.write_text(source)
        print(f"wrote {target}")


if __name__ == "__main__":
    main()
