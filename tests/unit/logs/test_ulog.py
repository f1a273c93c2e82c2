"""ULog of PX4: every cell as pyulog has it, damage that loses no more than its own records, stamps, other tables."""

from __future__ import annotations

import os
import random
import struct
from pathlib import Path

import numpy as np
import pytest
import ulog_writer as w

from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.formats.ulog.file import UlogLog

ROWS = 400
FORMATS = (
    w.message_format("sensor", "uint64_t timestamp;float[3] xyz;int16_t count;bool ok;uint8_t[3] _padding0;")
    + w.message_format("part", "uint32_t rpm;int8_t level;uint8_t[3] _padding0;")
    + w.message_format("esc", "uint64_t timestamp;part[2] esc;part best;char[8] name;double big;")
)


def rows(at: int) -> bytes:
    us = 1_000_000 + at * 10_000
    esc = (us + 1, 100 + at, -1, 0, 0, 0, 200, 2, 0, 0, 0, at, 3, 0, 0, 0, b"left", 0.1 * at)
    return (
        w.row(0, "Q3fhb", us, at, 0.5, float("nan") if at == 7 else -1.5, at - 200, at % 2)
        + w.row(1, "Q3fhb", us + 2, 1, 2, 3, -at, 1)
        + w.row(2, "QIb3BIb3BIb3B8sd", *esc)
    )


def made(count: int = ROWS) -> bytes:
    begin = w.head() + FORMATS + w.information("sys_name", "PX4") + w.parameter("RO_SPEED_LIM", 2.5)
    begin += w.parameter("SYS_AUTOSTART", 1061) + w.default("RO_SPEED_LIM", -1.0)
    begin += w.subscription(0, "sensor") + w.subscription(1, "sensor", 1) + w.subscription(2, "esc")
    middle = w.text(4, 3_000_000, "Preflight Fail") + w.parameter("RO_SPEED_LIM", 3.0) + w.dropout(17) + w.sync()
    middle += w.tagged_text(6, 3, 3_000_000, "tagged")
    half = count // 2
    return begin + b"".join(map(rows, range(half))) + middle + b"".join(map(rows, range(half, count)))


def saved(folder: Path, content: bytes) -> Path:
    path = folder / "flight.log"  # formats are told by content
    path.write_bytes(content)
    return path


def hold_against_pyulog(path: Path) -> None:
    """Each cell of each message, bit by bit."""
    theirs = pytest.importorskip("pyulog").ULog(str(path))
    with UlogLog(path) as log:
        everything = log.read(raw=True)
        held = 0
        for data in theirs.data_list:
            table = log[data.name]
            own = np.ones(len(table), bool) if table.instance is None else table.values("multi_id") == data.multi_id
            for column, wanted in data.data.items():
                base, _, index = column.rpartition("[")
                name, place = (base, int(index[:-1])) if base and base in table.columns else (column, None)
                if table.columns[name].kind == "text":
                    letters = [chr(code) for code in wanted.view(np.uint8)]
                    texts = table.values(name)[own]
                    assert all(
                        letter == (text + "\0" * 100)[place or 0] for letter, text in zip(letters, texts, strict=True)
                    )
                    continue
                for values in (table.values(name, raw=True)[own], everything[data.name][name][own]):
                    ours = values if place is None else values[:, place]
                    assert ours.dtype == wanted.dtype.newbyteorder("=")
                    assert np.ascontiguousarray(ours).tobytes() == np.ascontiguousarray(wanted).tobytes()
            held += len(data.data["timestamp"])
        assert held == sum(len(table) for name, table in log.tables.items() if name in everything)
        said = log.tables.get("logged_messages")
        texts = [] if said is None else said["message"].tolist()
        tagged = [each.message for some in theirs.logged_messages_tagged.values() for each in some]
        assert sorted(texts) == sorted([each.message for each in theirs.logged_messages] + tagged)


def test_every_cell_as_pyulog(tmp_path: Path) -> None:
    hold_against_pyulog(saved(tmp_path, made()))


@pytest.mark.skipif("XITL_ULOGS" not in os.environ, reason="XITL_ULOGS names no folder with ULog files")
def test_every_cell_of_real_logs() -> None:
    for path in sorted(Path(os.environ["XITL_ULOGS"]).glob("*.ulg")):
        hold_against_pyulog(path)


def test_tables(tmp_path: Path) -> None:
    with open_log(saved(tmp_path, made())) as log:
        assert (log.format, log.base, log.health.degraded) == ("ulog", "boot", False)
        assert list(log) == ["dropouts", "esc", "logged_messages", "parameters", "sensor"]
        sensor = log["sensor"]
        assert sensor.instance == "multi_id"
        assert list(sensor.columns) == ["multi_id", "timestamp", "xyz", "count", "ok"]
        assert sensor.columns["xyz"].shape == (3,)
        assert list(log["esc"].columns)[:4] == ["timestamp", "esc[0].rpm", "esc[0].level", "esc[0]._padding0"]
        assert log["esc"]["name"][0] == "left"
        assert log.signal("sensor[1].xyz[2]").values[0] == 3.0
        assert log["parameters"]["name"].tolist() == ["RO_SPEED_LIM", "SYS_AUTOSTART", "RO_SPEED_LIM"]
        assert log["parameters"]["value"].tolist() == [2.5, 1061.0, 3.0]
        assert log["parameters"]["default"].tolist() == [-1.0, 1061.0, -1.0]
        assert log["dropouts"]["duration"].tolist() == [17]
        assert log["logged_messages"]["level"].tolist() == [4, 6]
        assert log.facts["sys_name"] == "PX4"


def test_stamps(tmp_path: Path) -> None:
    # What was published long before the log, what has no stamp, and a stamp with a flipped bit.
    content = bytearray(w.head(100_000_000) + FORMATS + w.subscription(0, "sensor") + w.subscription(1, "sensor", 1))
    content += w.row(1, "Q3fhb", 2_000_000, 1, 2, 3, 4, 1)
    flipped = 0
    for at in range(200):
        flipped = len(content) if at == 100 else flipped
        content += w.row(0, "Q3fhb", 100_000_000 + at * 10_000, 1, 2, 3, 4, 1)
    content += w.row(1, "Q3fhb", 0, 1, 2, 3, 4, 1)
    with UlogLog(saved(tmp_path, bytes(content))) as log:
        assert log.span_ns == (100_000_000_000, 101_990_000_000)
        assert log["sensor"].stamp_ns[[0, -1]].tolist() == [100_000_000_000, 101_990_000_000]
        assert log["sensor"]["timestamp"][0] == 2_000_000
        assert not log.health.degraded
    content[flipped + 5 + 5] ^= 1 << 4
    with UlogLog(saved(tmp_path, bytes(content))) as log:
        assert log.health.replaced_stamps == 1
        assert log.span_ns == (100_000_000_000, 101_990_000_000)


def test_appended_data(tmp_path: Path) -> None:
    begin = FORMATS + w.subscription(0, "sensor")
    cut = w.row(0, "Q3fhb", 1_020_000, 1, 2, 3, 4, 1)[:-5]
    first = begin + w.row(0, "Q3fhb", 1_010_000, 1, 2, 3, 4, 1) + cut
    offset = len(w.head()) + len(first)
    behind = w.subscription(5, "sensor", 1) + w.row(5, "Q3fhb", 1_030_000, 1, 2, 3, 4, 1)
    path = saved(tmp_path, w.head(appended=(offset,)) + first + behind)
    hold_against_pyulog(path)
    with UlogLog(path) as log:
        assert log["sensor"]["timestamp"].tolist() == [1_010_000, 1_030_000]
        assert log.health.truncated_bytes == len(cut)


def test_a_flipped_size_loses_one_row(tmp_path: Path) -> None:
    content = bytearray(made())
    place = content.index(w.row(1, "Q3fhb", 1_000_002 + 100 * 10_000, 1, 2, 3, -100, 1))
    content[place + 1] ^= 0x40
    with UlogLog(saved(tmp_path, bytes(content))) as log:
        assert len(log["sensor"]) == 2 * ROWS - 1
        assert (log.health.damaged, log.health.damage[0].place, log.health.lost_bytes) == (1, place, 28)


def test_damage_among_the_formats_keeps_the_other_messages(tmp_path: Path) -> None:
    content = bytearray(made())
    content[content.index(b"esc:uint64_t")] = 0xFF
    with UlogLog(saved(tmp_path, bytes(content))) as log:
        assert len(log["sensor"]) == 2 * ROWS
        assert log.health.undecoded["esc"] == (ROWS, "the log has no format 'esc'")


@pytest.mark.parametrize("cut", [0, 3, 20, 60])
def test_truncated(tmp_path: Path, cut: int) -> None:
    whole = made()
    place = whole.index(rows(ROWS - 1))
    with UlogLog(saved(tmp_path, whole[: place + cut])) as log:
        row_bytes = 28
        assert len(log["sensor"]) == 2 * (ROWS - 1) + cut // row_bytes
        assert log.health.truncated_bytes == cut % row_bytes


def test_refused(tmp_path: Path) -> None:
    for content in (w.MAGIC, w.MAGIC + b"\x01" + bytes(8), w.MAGIC + bytes(4000)):
        with pytest.raises(LogError, match="without a readable record"):
            open_log(saved(tmp_path, content))


def damaged(content: bytes, chance: random.Random) -> bytes:
    found = bytearray(content)
    way = chance.randrange(4)
    if way == 0:
        return content[: chance.randrange(len(content))]
    if way == 1:
        for _ in range(chance.choice((1, 5, 200))):
            found[chance.randrange(len(found))] ^= 1 << chance.randrange(8)
    elif way == 2:
        at = chance.randrange(len(found))
        del found[at : at + chance.randrange(1, 2000)]
    else:
        for _ in range(20):  # in the descriptions
            found[chance.randrange(700)] = chance.randrange(256)
    return bytes(found)


@pytest.mark.parametrize("seed", range(60))
def test_any_damage_is_read_or_refused(tmp_path: Path, seed: int) -> None:
    path = saved(tmp_path, damaged(made(), random.Random(seed)))
    try:
        log = open_log(path)
    except LogError:
        return
    with log:
        for table in log.tables.values():
            assert len(table.stamp_ns) == len(table.file_offset) == len(table)
            for column in table.columns:
                assert len(table.values(column)) == len(table)
        size = log.health.lost_bytes + log.health.truncated_bytes
        assert 0 <= size <= path.stat().st_size
        assert log.health.as_json()


def test_a_number_without_a_description_is_counted(tmp_path: Path) -> None:
    content = w.head() + FORMATS + w.subscription(0, "sensor")
    line = w.row(0, "Q3fhb", 1_010_000, 1, 2, 3, 4, 1)
    content += line + w.record("D", struct.pack("<HQ", 77, 5)) + line + w.record("Z", b"later") + line
    with UlogLog(saved(tmp_path, content)) as log:
        assert len(log["sensor"]) == 3
        assert set(log.health.undecoded) == {"message 77", "record type 'Z'"}
