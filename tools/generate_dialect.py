"""Generate agent/wire/dialect.py from agent/wire/fleet.xml with mavgen; `--check` says whether it is current.

The fields of XITL_BRIDGE_STATUS in agent/wire/xitl.xml come from agent/bridges/counts.py and are renewed first.

Four things are changed in mavgen's output, for a slow board's sake. Its checksum is slow without a compiled
package: `agent.wire.crc` takes its place. Its methods that make and send a message are left out: the link does that,
and they are half of what is loaded. Its annotations stay text. A message has no header before somebody reads it, and
what all messages of a class share belongs to the class. What mavgen does not tell is added: how much of a payload
MAVLink 1 has.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
from dataclasses import fields
from pathlib import Path

from pymavlink.generator import mavgen, mavparse

from agent.bridges.counts import FIRST_FIELDS, UINT32, BridgeCounts
from xitl_cli.record.cdr import MessageType

CHECKSUM = re.compile(r"^# CRC calculation using fastcrc.*?^x25crc = [^\n]*\n", flags=re.M | re.S)
SENDERS = re.compile(r"^    def \w+_(?:encode|send)\(self, .*?(?=^    def |\Z)", flags=re.M | re.S)
IMPORTS = re.compile(r"^import hashlib$", flags=re.M)
SHARED = re.compile(
    r"^        MAVLink_message\.__init__\(self, (\w+)\.id, \1\.msgname\)\n"
    + "".join(rf"        self\._{name} = \1\.{name}\n" for name in ("fieldnames", "instance_field", "instance_offset")),
    flags=re.M,
)
OF_CLASS = re.compile(r"^    (fieldnames|instance_field|instance_offset)(: [^=\n]*)? = ", flags=re.M)
NAME = re.compile(r"^    msgname = ", flags=re.M)
BASE = "class MAVLink_message(object):\n"
HEADER = '''class _HeaderWhenRead:
    """Makes the header of a message when it is first read: few are. The frame of a received message has its values."""

    def __get__(self, message: MAVLink_message, owner: type) -> MAVLink_header:
        frame = message._msgbuf
        if frame:
            header = MAVLink_header(owner.id, frame[2], frame[3], frame[1], frame[4], frame[5], frame[6])
        else:
            header = MAVLink_header(owner.id)
        message._header = header
        return header


'''
NUMBER = "        return self._header.msgId\n"
UNNUMBERED = re.compile(
    r"^class MAVLink_(bad_data|unknown)\(MAVLink_message\):\n    \"{3}.*?\"{3}\n", flags=re.M | re.S
)
FIRST_VALUES = """    _header = _HeaderWhenRead()
    _payload = _crc = _link_id = _instances = None
    _msgbuf = b""
    _signed = False
"""
WIRE = Path(__file__).resolve().parent.parent / "agent" / "wire"
BRIDGE_STATUS = re.compile(r'(<message id="54014".*?name="time_usec".*?\n)(.*?)(\n    </message>)', flags=re.S)


def wire_fields(counts: type[BridgeCounts] = BridgeCounts) -> list[str]:
    """Lines of the fields of XITL_BRIDGE_STATUS after its time. Those after the first release are extensions."""
    lines = []
    columns = MessageType(counts).fields
    for number, (column, field) in enumerate(zip(columns, fields(counts), strict=True)):
        if number == FIRST_FIELDS:
            lines.append("<extensions/>")
        kind, unit = field.metadata.get("wire", UINT32), field.metadata.get("unit")
        units = f' units="{unit}"' if unit else ""
        meaning = column.meaning[:1].upper() + column.meaning[1:]
        lines.append(f'<field type="{kind}" name="{field.name}"{units}>{meaning}</field>')
    return lines


def renewed(xml: str, counts: type[BridgeCounts] = BridgeCounts) -> str:
    """The text of xitl.xml with the fields of XITL_BRIDGE_STATUS renewed."""
    lines = "\n".join(f"      {line}" for line in wire_fields(counts))
    text, replaced = BRIDGE_STATUS.subn(lambda found: found[1] + lines + found[3], xml)
    if replaced != 1:
        raise SystemExit("xitl.xml has no XITL_BRIDGE_STATUS that begins with time_usec: put it back")
    return text


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
    source, shared = SHARED.subn("", source)
    source, of_class = OF_CLASS.subn(r"    \1 = _\1 = ", source)
    source, named = NAME.subn("    msgname = _type = ", source)
    begin = source.find(BASE)
    inside = source.find("\n\n    def __init__", begin) + 1
    if begin < 0 or not inside or named != shared + 1 or of_class != 3 * named:
        raise SystemExit("mavgen writes its messages in a new way: adapt tools/generate_dialect.py")
    source = source[:begin] + HEADER + source[begin:inside] + FIRST_VALUES + source[inside:]
    source, numbered = UNNUMBERED.subn(
        lambda found: f"{found[0]}\n    id = MAVLINK_MSG_ID_{found[1].upper()}\n", source
    )
    if numbered != 2 or source.count(NUMBER) != 1:
        raise SystemExit("mavgen writes its numbers in a new way: adapt tools/generate_dialect.py")
    source = source.replace(
        NUMBER, "        return type(self).id  # an instance of STATUSTEXT has a field of this name\n"
    )
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
    declared = WIRE / "xitl.xml"
    text = renewed(declared.read_text())
    if check and declared.read_text() != text:
        sys.exit(f"{declared} does not match agent/bridges/counts.py: run `make dialect`")
    if not check:
        declared.write_text(text)
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
