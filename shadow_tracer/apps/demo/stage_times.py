# SPDX-License-Identifier: Apache-2.0
"""Stage times of many frames, as a table."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

WAY = "stamp to last mask"


@dataclass(frozen=True)
class StageRow:
    """Times of one stage over all frames, milliseconds."""

    stage: str
    median: float
    p95: float


def rows(frames: Sequence[Mapping[str, float]]) -> list[StageRow]:
    """One row per stage, in the order of first appearance.

    Args:
        frames: per frame, stage name -> milliseconds.
    """
    names = list(dict.fromkeys(name for frame in frames for name in frame))
    table = []
    for name in names:
        times = [frame[name] for frame in frames if name in frame]
        table.append(StageRow(name, float(np.median(times)), float(np.percentile(times, 95))))
    return table


def markdown(title: str, facts: Mapping[str, Any], table: Sequence[StageRow]) -> str:
    """The table with what it was measured on, as Markdown."""
    lines = [f"# Stage times: {title}", "", *(f"- {key}: {value}" for key, value in facts.items()), ""]
    lines += ["| stage | median [ms] | p95 [ms] |", "|---|---:|---:|"]
    lines += [f"| {row.stage} | {row.median:.2f} | {row.p95:.2f} |" for row in table]
    return "\n".join(lines) + "\n"


def save(folder: Path, title: str, facts: Mapping[str, Any], table: Sequence[StageRow]) -> list[Path]:
    """Writes stage_times.md and stage_times.json; returns their paths."""
    text, data = folder / "stage_times.md", folder / "stage_times.json"
    text.write_text(markdown(title, facts, table), encoding="utf-8")
    stages = {row.stage: {"median_ms": round(row.median, 4), "p95_ms": round(row.p95, 4)} for row in table}
    data.write_text(json.dumps({"title": title, **facts, "stages": stages}, indent=2) + "\n", encoding="utf-8")
    return [text, data]
