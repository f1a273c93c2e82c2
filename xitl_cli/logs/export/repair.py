"""Rewriting of a recording that is damaged or that its writer did not close."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xitl_cli.logs.export.files import make_directory, part_of, refuse_present
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.formats.mcap.recording_set import RecordingSet
from xitl_cli.logs.formats.mcap.rewrite import Rewritten
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log, LogHealth
from xitl_cli.logs.model.text import plural


@dataclass(frozen=True, slots=True)
class RepairResult:
    """Result of a repair."""

    source: Path
    out: Path | None
    """None if the file is whole: then nothing is written."""
    written: Rewritten | None
    """None if nothing is written."""
    health: LogHealth
    """Of the source file."""

    @property
    def sentence(self) -> str:
        if self.out is None or self.written is None:
            return f"{self.source}: is complete, so nothing was written"
        done = self.written
        parts = [
            f"{plural(done.messages, 'message')} of {plural(done.topics, 'topic')}",
            f"{plural(done.chunks, 'chunk')}, {done.rebuilt} of them rebuilt",
            plural(done.attachments, "attachment") if done.attachments else "",
            plural(done.metadata, "metadata record") if done.metadata else "",
        ]
        return f"{self.out}: {'; '.join(part for part in parts if part)}"

    def as_json(self) -> dict[str, Any]:
        return {
            "file": str(self.source),
            "out": None if self.out is None else str(self.out),
            "written": None if self.written is None else self.written.as_json(),
            "health": self.health.as_json(),
        }


def repair_log(log: Log, out: Path | None, overwrite: bool) -> RepairResult:
    """Write all readable data of a recording to `out`, by default next to it as `<name>-repaired.mcap`.

    Of a split recording, it is the damaged file, and the other files stay.

    Raises LogError for other formats, for a recording without readable data, for an unwritable path and for an existing
    file.
    """
    if isinstance(log, RecordingSet):
        damaged = [part for part in log.parts if not part.examine()]
        if len(damaged) > 1:
            later = [part.path for part in damaged if part is not log.parts[0]]
            named = ", ".join(part.path.name for part in damaged)
            raise LogError(
                f"{log.path}: {named} of this split recording are damaged; repair them one by one: first "
                f"`xitl logs repair {later[0]}`, and put the repaired file in its place"
            )
        log = damaged[0] if damaged else log.parts[0]
    if not isinstance(log, McapLog):
        kinds = {"dataflash": "a DataFlash log", "tlog": "a telemetry log"}
        kind = kinds.get(log.format, "a bag of ROS")
        raise LogError(
            f"{log.path}: is {kind}, which needs no repair: it has no index, and every command reads the data after "
            "damage; `xitl logs export` writes the readable data"
        )
    path = out or log.path.with_name(f"{log.path.stem}-repaired.mcap")
    if path.is_dir():
        path = path / f"{log.path.stem}-repaired.mcap"
    if log.examine():
        return RepairResult(log.path, None, None, log.health)
    if not log.health.records:
        raise LogError(f"{log.path}: has no readable message; there is nothing to repair")
    refuse_present([path], overwrite)
    make_directory(path.parent)
    with part_of(path, overwrite) as part, part.open("xb") as file:
        written = log.rewrite(file)
    return RepairResult(log.path, path, written, log.health)
