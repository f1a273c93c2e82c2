"""The folder of a campaign: a line per run at its end (results.jsonl), and the table (.parquet) at intervals.

campaign.json    the plan with its axes, verdicts and figures
plan.yaml        a copy of the plan
results.jsonl    a JSON object per run, in the order in which they ended
results.parquet  the same, sorted by number
runs/NNNN/       folders of kept runs
"""

from __future__ import annotations

import errno
import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any

from agent import __version__
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.execution import RAN, Row
from xitl_cli.plugins.campaign.plan import SAME_RUNS, CampaignPlan

if TYPE_CHECKING:
    import pandas as pd  # type: ignore[import-untyped]

CAMPAIGN, PLAN, LINES, TABLE, RUNS = "campaign.json", "plan.yaml", "results.jsonl", "results.parquet", "runs"
RUNS_FOLDER = "runs"
"""Default parent folder of campaigns."""
FORMAT = 1
HEAD = ("number", "key")
OUTCOME = ("status", "exit_code", "error", "passed")
TAIL = ("attempts", "wall_s", "directory", "command")
NOT_COMPARED = ("wall_s", "attempts", "directory")
"""Columns that depend on the machine; all others of a plan are the same on every machine."""
_TABLE_EVERY_S = 30.0
_FULL = (errno.ENOSPC, errno.EDQUOT)


class FullDiskError(UserError):
    """No space for results. Earlier results are kept."""


@dataclass(frozen=True)
class ResultTable:
    """The completed runs of a campaign, by number.

    Columns: number, key, one per axis, seed, one per kept figure, one per verdict (its text: true, false or null),
    status, exit_code, error, passed, attempts, wall_s, directory, command.
    """

    folder: Path
    about: Mapping[str, Any]
    """Contents of campaign.json."""
    rows: Sequence[Row]

    @classmethod
    def read(cls, folder: Path) -> ResultTable:
        """Read the results in a folder, also of a running campaign. Raises UserError if there are none."""
        about = read_about(folder)
        rows = {row["key"]: row for row in _lines(folder / LINES)}
        return cls(folder, about, sorted(rows.values(), key=lambda row: row["number"]))

    @property
    def axes(self) -> tuple[str, ...]:
        """Keys of the axes."""
        return tuple(self.about["axes"])

    @property
    def figures(self) -> tuple[str, ...]:
        """Paths of the kept figures."""
        return tuple(self.about["keep"])

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Texts of the verdicts."""
        return tuple(self.about["verdicts"])

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns, in order."""
        return (*HEAD, *self.axes, "seed", *self.figures, *self.verdicts, *OUTCOME, *TAIL)

    def column(self, name: str) -> list[Any]:
        """Return one column, None for runs without a value."""
        return [row.get(name) for row in self.rows]

    def __len__(self) -> int:
        return len(self.rows)

    def worst(self, count: int = 5) -> list[Row]:
        """Return runs that did not pass: first those without figures, then by failed verdicts, then by distance to the
        limit.
        """
        failed = [row for row in self.rows if not row["passed"]]
        middles: dict[str, float] = {}
        for path in self.figures:
            if values := sorted(value for value in self.column(path) if is_number(value)):
                middles[path] = values[len(values) // 2]

        def badness(row: Row) -> tuple[bool, int, float]:
            broken = [text for text in self.verdicts if row.get(text) is not True]
            off = [
                abs(row[path] - middle) / max(abs(middle), 1e-9)
                for path, middle in middles.items()
                if any(path in text for text in broken) and is_number(row.get(path))
            ]
            return row["status"] not in RAN, len(broken), max(off, default=0.0)

        return sorted(failed, key=badness, reverse=True)[:count]

    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame (needs pandas)."""
        import pandas

        return pandas.DataFrame([[row.get(name) for name in self.columns] for row in self.rows], columns=self.columns)

    def write_parquet(self) -> Path:
        """Write results.parquet atomically. A column of several types is written as text. Raises OSError."""
        import pyarrow  # type: ignore[import-untyped]
        from pyarrow import parquet

        names = list(dict.fromkeys(self.columns))
        arrays = {name: _array(pyarrow, self.column(name)) for name in names}
        path = self.folder / TABLE
        temporary = path.with_suffix(".tmp")
        try:
            parquet.write_table(pyarrow.table(arrays), temporary)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        return path


def is_number(value: Any) -> bool:
    """Return True if a figure or a value of an axis is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _array(pyarrow: Any, values: list[Any]) -> Any:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        values = [None if value is None else float(value) for value in values]
    elif len(kinds) > 1 or dict in kinds:
        values = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
    try:
        return pyarrow.array(values)
    except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError, OverflowError):
        return pyarrow.array([None if value is None else json.dumps(value) for value in values])


def read_about(folder: Path) -> dict[str, Any]:
    """Read campaign.json of a folder. Raises UserError if there is none."""
    try:
        about: dict[str, Any] = json.loads((folder / CAMPAIGN).read_text(encoding="utf-8"))
        return about
    except OSError:
        raise UserError(f"{folder}: contains no campaign ({CAMPAIGN} is missing); check the folder") from None
    except ValueError:
        raise UserError(f"{folder / CAMPAIGN}: is damaged; restore it, or choose another --out") from None


def _lines(path: Path) -> Iterator[Row]:
    """Yield complete lines; the last line may be incomplete."""
    try:
        with path.open("rb") as file:
            for line in file:
                try:
                    row = json.loads(line)
                except (ValueError, RecursionError):
                    continue
                if (
                    line.endswith(b"\n")
                    and isinstance(row, dict)
                    and isinstance(row.get("number"), int)
                    and isinstance(row.get("key"), str)
                    and {"status", "passed"} <= row.keys()
                ):
                    yield row
    except FileNotFoundError:
        return


@dataclass
class CampaignFolder:
    """Output folder of a campaign."""

    path: Path
    plan: CampaignPlan
    done: dict[str, Row] = field(default_factory=dict)
    """Existing rows, by key."""
    _file: IO[bytes] | None = None
    _next_table_s: float = 0.0

    @classmethod
    def create(cls, path: Path, plan: CampaignPlan, extra: Mapping[str, Any] | None = None) -> CampaignFolder:
        """Create a folder. Raises UserError if `path` already contains a campaign or is unusable."""
        if (path / CAMPAIGN).exists():
            count = sum(1 for _ in _lines(path / LINES))
            raise UserError(f"{path}: already contains a campaign ({count} runs); add --resume or choose another --out")
        about = {
            "format": FORMAT,
            "xitl": __version__,
            "name": plan.name,
            "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
            "plan": plan.document(),
            "digest": plan.digest(),
            "base": plan.base.name,
            "axes": list(plan.axis_keys),
            "seeds": list(plan.seeds),
            "keep": list(plan.keep),
            "verdicts": [verdict.text for verdict in plan.verdicts],
            **plan.analysis(),
            **(extra or {}),
        }
        try:
            (path / RUNS).mkdir(parents=True, exist_ok=True)
            (path / PLAN).write_bytes(plan.path.read_bytes())
            temporary = path / f"{CAMPAIGN}.tmp"
            temporary.write_text(json.dumps(about, indent=2, default=list) + "\n", encoding="utf-8")
            temporary.replace(path / CAMPAIGN)
        except OSError as error:
            raise UserError(f"{path}: cannot be used ({error.strerror}); choose another --out") from None
        return cls(path, plan)

    @classmethod
    def resume(cls, path: Path, plan: CampaignPlan) -> CampaignFolder:
        """Open an existing folder. Raises UserError if it belongs to another plan, or the plan has changed since."""
        about = read_about(path)
        if about["digest"] != plan.digest():
            raise UserError(f"{path}: {_difference(about['plan'], plan)}; restore it, or choose another --out")
        if about["xitl"] != __version__:
            raise UserError(
                f"{path}: was started by xitl {about['xitl']}, but this is {__version__}; resume it with that version, "
                "or choose another --out"
            )
        lines = path / LINES
        if lines.exists():  # drop a partial line at the end
            with lines.open("rb+") as file:
                size = file.seek(0, os.SEEK_END)
                back = min(size, 1 << 20)
                file.seek(size - back)
                tail = file.read(back)
                if tail and not tail.endswith(b"\n"):
                    file.truncate(size - back + tail.rfind(b"\n") + 1)
        return cls(path, plan, {row["key"]: row for row in _lines(lines)})

    def append(self, row: Row) -> None:
        """Write a row at once. Raises FullDiskError if the disk is full, and leaves no partial line."""
        line = json.dumps(row, allow_nan=False, default=list).encode() + b"\n"
        at = None
        try:
            if self._file is None:
                self._file = (self.path / LINES).open("ab", buffering=0)
            at = self._file.seek(0, os.SEEK_END)
            written = self._file.write(line)
            if written != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            if self._file is not None and at is not None:
                os.truncate(self._file.fileno(), at)
            raise self._no_room(error) from None
        self.done[row["key"]] = row
        if time.monotonic() >= self._next_table_s:
            begun_s = time.monotonic()
            if self._next_table_s:
                self.write_table()
            spent_s = time.monotonic() - begun_s
            self._next_table_s = time.monotonic() + max(_TABLE_EVERY_S, 100.0 * spent_s)

    def table(self) -> ResultTable:
        """Return the present results."""
        return ResultTable(self.path, read_about(self.path), sorted(self.done.values(), key=lambda row: row["number"]))

    def write_table(self) -> None:
        """Write results.parquet. Raises FullDiskError."""
        try:
            self.table().write_parquet()
        except OSError as error:
            raise self._no_room(error) from None

    def __enter__(self) -> CampaignFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file of lines."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _no_room(self, error: OSError) -> UserError:
        kept = f"{len(self.done)} runs are kept; continue with --resume"
        if error.errno in _FULL:
            return FullDiskError(f"{self.path}: no room for results ({error.strerror}); free space: {kept}")
        return UserError(f"{self.path}: results cannot be written ({error.strerror}): {kept}")


def open_folder(plan: CampaignPlan, out: Path | None, resume: bool) -> CampaignFolder:
    """Return the folder of a campaign, new or to be resumed. Raises UserError.

    A new folder is `out`, or `runs/<plan>-<UTC time>` with a number appended if the name is taken.
    """
    if not resume:
        base = Path(RUNS_FOLDER) / f"{plan.name}-{datetime.now(UTC).strftime('%Y%m%dT%H%M%SZ')}"
        path, number = out or base, 1
        while out is None and path.exists():
            number += 1
            path = base.with_name(f"{base.name}-{number}")
        return CampaignFolder.create(path, plan)
    earlier = campaign_folders(plan, out)
    if not earlier and out is None:
        raise UserError(f"{RUNS_FOLDER}/{plan.name}-…: contains no campaign of this plan; name its folder with --out")
    return CampaignFolder.resume(out or earlier[-1], plan)


def campaign_folders(plan: CampaignPlan, out: Path | None) -> list[Path]:
    """Return folders of earlier campaigns with the plan's name, the latest last: only `out`, or those in `runs/`."""
    candidates = [out / CAMPAIGN] if out is not None else Path(RUNS_FOLDER).glob(f"{plan.name}-*/{CAMPAIGN}")
    existing = [path for path in candidates if path.is_file()]
    return [path.parent for path in sorted(existing, key=lambda path: path.stat().st_mtime)]


def _difference(before: Mapping[str, Any], plan: CampaignPlan) -> str:
    """Describe the differences of the plan from the recorded one."""
    now = plan.document()
    changed = [
        key for key in dict.fromkeys([*before, *now]) if before.get(key) != now.get(key) and key not in SAME_RUNS
    ]
    if changed == ["base_digest"]:
        return f"the base {plan.base.name} has changed since the start of the campaign"
    names = [key for key in changed if key != "base_digest"]
    return f"was started with another plan than {plan.path} (it differs in {', '.join(names)})"
