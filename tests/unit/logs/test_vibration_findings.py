"""Vibration: levels against their limits, clipping, spectra against lines and noise that were put there."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Severity
from xitl_cli.plugins.logs.analyses.vibration import analyse, read_batches, welch_spectrum

S = 1_000_000_000
ROWS = 600


def vibe(level: float = 5.0, clip: np.ndarray | None = None, over: slice | None = None) -> MadeTable:
    x = np.full(ROWS, 5.0)
    if over is not None:
        x[over] = level
    columns = {"VibeX": x, "VibeY": np.full(ROWS, 4.0), "VibeZ": np.full(ROWS, 3.0)}
    return MadeTable("VIBE", np.arange(ROWS) * S // 10, columns | {"Clip": np.zeros(ROWS) if clip is None else clip})


def found(*tables: MadeTable) -> dict[str, Severity]:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return {finding.key: finding.severity for finding in section.findings}


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        (29.0, {}),
        (35.0, {"vibration.high": Severity.NOTICE}),
        (65.0, {"vibration.high": Severity.WARNING}),
    ],
)
def test_levels_by_their_limits(level, expected):
    assert found(vibe(level, over=slice(100, 200))) == expected


def test_a_single_knock_is_none():
    assert found(vibe(80.0, over=slice(100, 103))) == {}


def test_clipping_counts_while_armed():
    clip = np.zeros(ROWS)
    clip[50:] = 3
    clip[400:] = 8
    armed = MadeTable("ARM", [30 * S], {"ArmState": [1]})
    section = analyse(MadeLog(vibe(clip=clip), armed))
    assert section is not None
    (finding,) = section.findings
    assert finding.key == "vibration.clipping"
    assert (finding.evidence[0].at_ns, finding.evidence[0].value) == (40 * S, "5")
    disarmed = MadeTable("ARM", [59 * S], {"ArmState": [1]})
    assert found(vibe(clip=clip), disarmed) == {}


def test_a_spectrum_integrates_to_the_variance_and_finds_a_line():
    rate_hz, amplitude = 1000.0, 2.0
    at_s = np.arange(20_000) / rate_hz
    values = np.random.default_rng(0).standard_normal((len(at_s), 3))
    flat = welch_spectrum([values], rate_hz, 1024)
    assert flat is not None
    variance = (flat.density**2).sum(axis=0) * rate_hz / 1024
    np.testing.assert_allclose(variance, 1.0, rtol=0.05)  # 38 independent spectra of 512 lines: 0.7 %, and the window
    assert flat.peak(5.0) is None
    values[:, 1] += amplitude * np.sin(2.0 * np.pi * 187.5 * at_s)
    lined = welch_spectrum([values], rate_hz, 1024)
    assert lined is not None
    peak = lined.peak(5.0)
    assert peak is not None
    assert peak[0] == pytest.approx(187.5, abs=rate_hz / 1024)
    # A sine in a Hann window: amplitude^2 / 2 over 1.5 lines of width, on top of the noise.
    assert peak[1] == pytest.approx(amplitude / np.sqrt(2.0) / np.sqrt(1.5 * rate_hz / 1024), rel=0.1)


def batch_tables(
    count: int, line_hz: float, rate_hz: float = 1000.0, samples: int = 1024
) -> tuple[MadeTable, MadeTable]:
    """ISBH and ISBD of the accelerometer, one batch after another."""
    random = np.random.default_rng(1)
    blocks = samples // 32
    data = []
    for batch in range(count):
        wave = np.sin(2.0 * np.pi * line_hz * np.arange(samples) / rate_hz)[:, None] * [2.0, 0.0, 0.0]
        values = np.rint((wave + 0.05 * random.standard_normal((samples, 3))) * 200.0).astype(np.int16)
        data += [(batch, block, values[32 * block : 32 * block + 32]) for block in range(blocks)]
    number = [batch for batch, _, _ in data]
    heads = MadeTable(
        "ISBH", np.arange(count) * S,
        {"N": range(count), "type": [0] * count, "instance": [0] * count, "mul": [200] * count,
         "smp_cnt": [samples] * count, "SampleUS": range(count), "smp_rate": [rate_hz] * count},
        place=np.arange(count) * (blocks + 1),
    )  # fmt: skip
    rows = MadeTable(
        "ISBD", np.repeat(np.arange(count), blocks) * S,
        {"N": number, "seqno": [block for _, block, _ in data],
         **{axis: np.stack([each[:, place] for _, _, each in data]) for place, axis in enumerate("xyz")}},
        place=[batch * (blocks + 1) + 1 + block for batch, block, _ in data],
    )  # fmt: skip
    return heads, rows


def test_batches_are_put_together_and_show_their_line():
    heads, rows = batch_tables(6, 120.0)
    every = read_batches(MadeLog(heads, rows))
    assert (len(every.whole), every.broken) == (6, 0)
    assert every.whole[0].samples.shape == (1024, 3)
    section = analyse(MadeLog(vibe(), heads, rows))
    assert section is not None
    grid = next(grid for grid in section.grids if grid.key == "spectra")
    assert grid.rows[0][4] == pytest.approx(120.0, abs=1.0)


def test_a_batch_with_a_row_lost_is_left_out_and_counted():
    heads, rows = batch_tables(4, 120.0)
    keep = np.ones(len(rows), dtype=bool)
    keep[40] = False
    columns = {name: rows.values(name)[keep] for name in rows.columns}
    cut = MadeTable("ISBD", rows.stamp_ns[keep], columns, place=rows.file_offset[keep])
    every = read_batches(MadeLog(heads, cut))
    assert (len(every.whole), every.broken) == (3, 1)


def test_without_levels_it_says_what_to_log():
    columns = {name: np.sin(np.arange(100.0)) for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")}
    section = analyse(MadeLog(MadeTable("IMU", np.arange(100) * S // 50, columns)))
    assert section is not None
    assert any("VIBE" in lack for lack in section.lacks)
    assert any("spectrum" in lack.lower() for lack in section.lacks)
    assert analyse(MadeLog()) is None
