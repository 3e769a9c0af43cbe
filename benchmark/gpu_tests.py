# SPDX-License-Identifier: Apache-2.0
"""The tests that say something about a device, in groups that fail, hang or crash alone.

All of them need Warp, numpy and pytest only; what they need beyond that they ask for, and are skipped without it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from report import ROOT

# The most telling first: what does not fit into the time is left out from the end.
GROUPS: dict[str, tuple[str, ...]] = {
    "arithmetic": ("test/gpu/exact/test_determinant.py", "test/gpu/exact/test_blocks.py"),
    "frames": (
        "test/gpu/device/test_transfers.py",
        "test/gpu/occluders/test_world.py",
        "test/test_tracer_trace.py",
        "test/test_tracer_motion.py",
        "test/gpu/device/test_graphs.py",
    ),
    "cases of every pipeline": (
        "test/gpu/test_ties.py",
        "test/gpu/test_degenerate.py",
        "test/gpu/test_far.py",
        "test/gpu/test_determinism.py",
        "test/gpu/test_invariance.py",
    ),
    "closed surfaces": ("test/gpu/test_watertight.py", "test/gpu/test_front_face_culling.py"),
    "soups": ("test/gpu/test_soups.py", "test/gpu/test_fuzz.py"),
    "grids": tuple(f"test/gpu/accelerators/{grid}_grid" for grid in ("light", "spherical", "camera")),
    "cone hierarchies": tuple(f"test/gpu/accelerators/{kind}_hierarchy" for kind in ("cone", "paper")),
    "hard cases of grids and trees": tuple(
        f"test/gpu/accelerators/test_{name}.py"
        for name in ("crowds", "directions", "lights_on_triangles", "pitfalls", "small_queues", "stadium", "walls")
    ),
    "points and bounds": (
        "test/test_tracer_occluded.py",
        "test/test_tracer_states_at.py",
        "test/test_tracer_bounds.py",
        "test/test_tracer_sphere.py",
        "test/test_tracer_verify.py",
    ),
    "safeguards": ("test/gpu/test_safeguards.py",),
    "views": ("test/gpu/test_views.py",),
    "real data": ("test/test_tracer_real_data.py",),
}


def run_tests(
    device: str, folder: Path, seconds: float, jobs: int, groups: Iterable[str] = GROUPS, options: Iterable[str] = ()
) -> list[dict[str, Any]]:
    """Run groups, ``jobs`` at a time, until ``seconds`` have passed; a summary of each."""
    end = time.monotonic() + seconds

    def run(name: str) -> dict[str, Any]:
        return _run_group(name, device, folder, end - time.monotonic(), list(options))

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(run, groups))


def _run_group(name: str, device: str, folder: Path, seconds: float, options: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {"group": name, "files": list(GROUPS[name])}
    if seconds <= 0.0:
        return {**found, "failure": "no time was left"}
    results = folder / f"{name.replace(' ', '_')}.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junit-xml={results}"]
    environment = {**os.environ, "SHADOW_TRACER_TEST_DEVICES": device}
    try:
        done = subprocess.run(
            [*command, *options, *GROUPS[name]],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        said = error.stdout or b""
        return {**found, "failure": f"not done after {seconds:.0f} s", "output": said[-1500:].decode(errors="replace")}
    found["exit code"] = done.returncode
    if results.is_file():
        found |= summary(results)
    else:
        found |= {"failure": "pytest wrote no results", "output": (done.stdout + done.stderr)[-3000:]}
    return found


def summary(results: Path) -> dict[str, Any]:
    """Counts of a JUnit file, and which tests failed with what."""
    suite = ElementTree.parse(results).getroot().find("testsuite")
    assert suite is not None
    counts = {name: int(suite.get(name, "0")) for name in ("tests", "failures", "errors", "skipped")}
    failed = []
    for case in suite.iter("testcase"):
        problem = case.find("failure") if case.find("failure") is not None else case.find("error")
        if problem is not None:
            text = (problem.get("message") or "") + "\n" + (problem.text or "")[-600:]
            failed.append({"test": f"{case.get('classname')}::{case.get('name')}", "why": text[:1200]})
    passed = counts["tests"] - counts["failures"] - counts["errors"] - counts["skipped"]
    return {"passed": passed, **counts, "seconds": float(suite.get("time", "0")), "failed": failed[:20]}
