# SPDX-License-Identifier: Apache-2.0
"""Runs of small bags, at once and in windows, for tests."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from bag_journey import log_of

from shadow_tracer.apps import cli
from shadow_tracer.apps.bags.jobs import Options, Report, play
from shadow_tracer.apps.bags.plan import Cut, make

PARAMETERS: dict[str, Any] = {
    "device": "cpu", "fixed_frame": "odom", "lights.spot.type": "spot", "bounds.max_triangles": 1024,
    "bounds.max_rays": 1024, "light_names": ["lamp", "spot"], "lights.lamp.position": [0.4, -0.7, 0.3],
    "lights.spot.outer_angle": 0.3,
}  # fmt: skip
WISH = {"timing": False, "overlay": False, "copy": False, "visibility": False, "irradiance": False, "sun_map": False}


def given(parameters: dict[str, Any]) -> list[str]:
    """As options of the command line."""
    found = []
    for name, value in parameters.items():
        text = f"[{', '.join(map(str, value))}]" if isinstance(value, list) else value
        found += ["--param", f"{name}:={text}"]
    return found


def uncut(bag: Path, output: Path, parameters: dict[str, Any]) -> Path:
    """The output of one run."""
    assert cli.main(["bag", str(bag), str(output), "--no-timing", *given(parameters)]) == 0
    return output


def play_windows(
    bag: Path, out: Path, parameters: dict[str, Any], frames: int, **wish: bool
) -> tuple[list[tuple[str, int, bytes]], list[Report]]:
    """Messages of all windows of so many images one behind the other, the last window played first; and reports."""
    options = Options("/shadow_tracer", [], parameters, "", WISH | wish, 1)
    (entry,) = (plan := make([bag], out, options, Cut(frames), None, False)).entries
    assert not entry.error
    jobs = list(plan.jobs())
    reports = [play(job) for job in reversed(jobs)][::-1]
    assert [report.error for report in reports] == [""] * len(reports)
    return [row for job in jobs for row in log_of(Path(job.part))], reports


def perilous(pair: tuple[str, int]) -> str:
    """A job by a folder and a number: 1 dies at the first try, 2 at each, 3 fails at the first."""
    folder, number = pair
    mark = Path(folder) / str(number)
    first = not mark.exists()
    mark.write_text("")
    if number == 2 or (number == 1 and first):
        os.kill(os.getpid(), signal.SIGKILL)
    return "" if number == 3 and first else f"done {number}"


def marked(pair: tuple[str, int]) -> str:
    """A job that takes a little while and leaves a file."""
    folder, number = pair
    time.sleep(0.1)
    (Path(folder) / str(number)).write_text("")
    return "done"
