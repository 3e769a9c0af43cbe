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
    for package in ("warp-lang", "numpy", "embreex", "open3d", "moderngl", "ros-rclpy"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    model = next(
        (line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.machine(),
    )
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "commit": _git("rev-parse", "--short", "HEAD") or "unknown",
        "changed since": bool(_git("status", "--porcelain", "--", "shadow_tracer", "benchmark")),
        **versions,
    }


def _git(*command: str) -> str:
    try:
        done = subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip()


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []


def summary(values: list[float]) -> dict[str, float]:
    """Median and 95th percentile."""
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def threads(count: int) -> str:
    """Confine this process, with the threads it has and will have, to ``count`` cores; says in words what holds now.

    Call it before anything is measured. It binds all methods alike: us, who use as many threads as there are cores, and
    Embree, whose build does.
    """
    if not hasattr(os, "sched_setaffinity"):
        return "threads: not confined on this system (no sched_setaffinity); the builds of Embree may use all cores"
    cores = sorted(os.sched_getaffinity(0))[-count:]  # the first one is where the system does its own work
    for task in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(task), cores)
    return f"threads: everything, ours and the peers', on {len(cores)} core{'s' * (len(cores) > 1)} (affinity {cores})"


def table(rows: list[dict[str, Any]]) -> None:
    """Print ``rows``, all with the same keys."""
    cells = [[_text(value) for value in row.values()] for row in rows]
    head = list(rows[0])
    widths = [max(len(line[k]) for line in [head, *cells]) for k in range(len(head))]
    for line in [head, ["-" * width for width in widths], *cells]:
        print("| " + " | ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) + " |")


def note(text: str) -> None:
    """Print a remark beside the tables."""
    print(f"note: {text}", flush=True)


def header(title: str) -> None:
    """Print a title and the machine."""
    print(f"\n{title}\n" + ", ".join(f"{key} {value}" for key, value in machine().items()) + "\n")


def write_json(title: str, rows: list[dict[str, Any]], json_file: str | None) -> None:
    """Write ``rows`` to ``json_file``, if there is one, with the machine."""
    if json_file:
        text = json.dumps({"title": title, "machine": machine(), "rows": rows}, indent=1)
        Path(json_file).write_text(text + "\n")


def finish(title: str, rows: list[dict[str, Any]], json_file: str | None) -> None:
    """Print a table of ``rows`` (all with the same keys), and write it to ``json_file`` with the machine."""
    header(title)
    table(rows)
    write_json(title, rows, json_file)


def compact(count: int | None) -> str:
    """A count in at most five characters or so: 987, 45.6k, 13.2M; "-" for None."""
    if count is None:
        return "-"
    for unit, letter in ((1_000_000_000, "G"), (1_000_000, "M"), (10_000, "k")):
        if count >= unit:
            return f"{count / (1000 if letter == 'k' else unit):.3g}{letter}"
    return str(count)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
