# SPDX-License-Identifier: Apache-2.0
"""What every benchmark shares: the machine it ran on, medians, and how figures are written down."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent


def machine() -> dict[str, Any]:
    """Processor, cores, versions and commit."""
    versions = {}
    for package in ("warp-lang", "numpy", "embreex", "ros-rclpy"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    model = next(
        (line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.machine(),
    )
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "commit": commit.stdout.strip() or "unknown",
        **versions,
    }


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []


def summary(values: list[float]) -> dict[str, float]:
    """Median and 95th percentile."""
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def finish(title: str, rows: list[dict[str, Any]], json_file: str | None) -> None:
    """Print a table of ``rows`` (all with the same keys), and write it to ``json_file`` with the machine."""
    about = machine()
    print(f"\n{title}\n" + ", ".join(f"{key} {value}" for key, value in about.items()) + "\n")
    cells = [[_text(value) for value in row.values()] for row in rows]
    head = list(rows[0])
    widths = [max(len(line[k]) for line in [head, *cells]) for k in range(len(head))]
    for line in [head, ["-" * width for width in widths], *cells]:
        print("| " + " | ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) + " |")
    if json_file:
        Path(json_file).write_text(json.dumps({"title": title, "machine": about, "rows": rows}, indent=1) + "\n")


def _text(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)
