# SPDX-License-Identifier: Apache-2.0
"""Tests and figures on a GPU by one command: needs Warp, numpy and pytest, a checkout, and nothing installed.

    python benchmark/gpu_runner.py --json gpu.json

Scenes are made by code: robots with about 72,000 and 1,000,000 triangles first; 1024 x 1024 pixels, one light, a new
mesh and a new depth image in every frame, four of them in turn. Beside every variant of every pipeline, launched kernel
by kernel and as one recording, stand wp.Mesh (built, refitted) and a wp.Bvh rebuilt in place, each with an any-hit
query. Answers are mesh_bvh's on the CPU, compared with brute_force on a subset; every mask of every timed frame is
compared with them.

device: time of the stages between upload and download, by CUDA events. events: from the first to the last operation of
the frame. wall: numpy to numpy. A peer's rays are on its device beforehand, so its frame has no depth image to upload
and no rays to make.

Each step is a process of its own. What fails, hangs or crashes is in the file with its last words, and so are the
figures of the others; the file is written anew after every step. ``--device cpu`` tries the program without a GPU.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gpu_tests import GROUPS, run_tests
from report import ROOT, machine, table

from shadow_tracer import available_pipelines

_PEERS = ("wp.Bvh rebuild + any-hit", "wp.Mesh build + any-hit", "wp.Mesh refit + any-hit")
_SCENES = ("robots:72000", "robots:950000", "museum:75012", "stadium:72000")
_FIRST = (
    "light_grid/packed",
    "auto",
    "cone_hierarchy/linear",
    "mesh_bvh",
)  # what is worth most, should the time run out
_STEP_LIMIT = 90.0  # seconds for one method on one scene: what takes longer has hung


def methods() -> list[str]:
    """Peers, and all variants of all pipelines; those in front that are worth most."""
    variants = [f"{name}/{variant}" for name, several in available_pipelines().items() for variant in several]
    first = [name for start in _FIRST for name in variants if name.startswith(start)]
    return list(dict.fromkeys([*first[:1], *_PEERS, *first, *variants]))


class Runner:
    """Runs steps within a time limit, and keeps the file of what is known up to date."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self._options, self._folder = options, folder
        self._begin = time.monotonic()
        self._steps = 0
        self.found: dict[str, Any] = {"title": "GPU runner", "machine": machine() | _driver()}
        if options.commit:
            self.found["machine"]["commit"] = options.commit

    def left(self) -> float:
        """Seconds until the limit."""
        return float(self._options.seconds - (time.monotonic() - self._begin))

    def step(self, name: str, *arguments: str, limit: float = _STEP_LIMIT) -> list[dict[str, Any]]:
        """Rows of a step of ``gpu_measure.py``; the last one tells of a failure, if there was one."""
        limit = min(limit, self.left())
        if limit <= 1.0:
            return [{"failure": "no time was left"}]
        self._steps += 1
        path = self._folder / f"rows_{self._steps}.jsonl"
        program = str(ROOT / "benchmark" / "gpu_measure.py")
        command = [sys.executable, program, name, "--rows", str(path), "--device", self._options.device, *arguments]
        failure: dict[str, Any] = {}
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=limit, check=False)
            if done.returncode != 0:
                said = (done.stderr or done.stdout).strip()[-2000:]
                failure = {"failure": said or "ended without a word", "exit code": done.returncode}
        except subprocess.TimeoutExpired:
            failure = {"failure": f"not done after {limit:.0f} s"}
        rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
        return [*rows, failure] if failure else rows

    def note(self, **what: Any) -> None:
        """Keep and write down."""
        self.found |= what
        self.found["seconds"] = time.monotonic() - self._begin
        if self._options.json:
            target = Path(self._options.json)
            partial = target.with_suffix(".part")
            partial.write_text(json.dumps(self.found, indent=1) + "\n")
            os.replace(partial, target)

    def measure(self) -> None:
        """The table: what is worth most on all scenes, then the rest on all scenes."""
        options, rows = self._options, []
        cases: dict[str, dict[str, Any]] = {}
        for round in ([m for m in options.methods if _first(m)], [m for m in options.methods if not _first(m)]):
            for number, scene in enumerate(options.scenes if round else ()):
                file = str(self._folder / f"case_{number}.pickle")
                if scene not in cases:
                    words = ("--scene", scene, "--size", str(options.size), "--case", file)
                    cases[scene] = {"scene": scene, "method": "-", **self.step("case", *words, limit=180.0)[-1]}
                if "failure" in cases[scene]:
                    if cases[scene] not in rows:
                        rows.append(cases[scene])
                        show([cases[scene]])
                    continue
                about = {"scene": cases[scene]["scene"]}
                new: list[dict[str, Any]] = []
                effort = ("--frames", str(options.frames), "--seconds", str(options.figure_seconds))
                for method in round:
                    got = self.step("measure", "--case", file, "--method", method, *effort)
                    new += [{**about, "method": method, **row} for row in got]
                    self.note(rows=[*rows, *new])
                rows += new
                add_ratios([row for row in rows if row["scene"] == about["scene"]])
                self.note(rows=rows)
                show(new)


def _first(method: str) -> bool:
    return method in _PEERS or method.startswith(_FIRST)


def add_ratios(rows: list[dict[str, Any]]) -> None:
    """Adds to each of our rows with a moving mesh how many times as long the fastest peer that builds takes."""
    moving = [row for row in rows if row.get("mesh") == "moving" and "wall ms" in row]
    for what in ("device ms", "wall ms"):
        peers = [row[what]["median"] for row in moving if row["method"] in _PEERS and "refit" not in row["method"]]
        for row in moving:
            if peers and row["method"] not in _PEERS:
                row[f"{what.split()[0]} ratio"] = min(peers) / max(row[what]["median"], 1e-6)


def show(rows: list[dict[str, Any]]) -> None:
    """Print the rows of a scene."""
    timed = sorted((row for row in rows if "wall ms" in row), key=lambda row: (row["mesh"], row["device ms"]["median"]))
    if timed:
        print(f"\n{timed[0]['scene']} triangles, {timed[0]['rays']:,} rays")
        table([_cells(row) for row in timed])
    for row in rows:
        for kind in ("failure", "skipped"):
            if kind in row:
                print(f"{row['scene']}, {row['method']}: {kind}: {row[kind].splitlines()[-1]}")
    sys.stdout.flush()


def _cells(row: dict[str, Any]) -> dict[str, Any]:
    launched = row.get("launched")
    return {
        "mesh": row["mesh"],
        "method": row["method"],
        "graph": "yes" if row["graph"] else "no",
        **{f"{what} ms": f"{row[f'{what} ms']['median']:.3f}" for what in ("device", "events", "wall")},
        "device ratio": row.get("device ratio"),
        "wall ratio": row.get("wall ratio"),
        "launches": f"{launched['kernels']} + {launched['other']}" if launched else None,
        "MB": round(row.get("memory taken", row.get("device bytes", 0)) / 1e6),
        "frames": row["frames"],
        "wrong": row["wrong"],
    }


def _driver() -> dict[str, str]:
    """What the driver's own tool says of the GPU, if it is there."""
    fields = "name,driver_version,memory.total,clocks.sm,clocks.max.sm,clocks.mem,power.limit"
    try:
        done = subprocess.run(
            ["nvidia-smi", f"--query-gpu={fields}", "--format=csv,noheader"],
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(zip(fields.split(","), (text.strip() for text in done.stdout.split(",")), strict=False))


def _tests(runner: Runner, options: argparse.Namespace, folder: Path) -> None:
    share = runner.left() if options.only == "tests" else options.test_share * runner.left()
    groups = run_tests(options.device, folder, share, options.jobs, options.groups, options.pytest)
    runner.note(tests=groups)
    for group in groups:
        text = (
            group.get("failure") or f"{group['passed']} passed, {group['skipped']} skipped in {group['seconds']:.0f} s"
        )
        for failed in group.get("failed", ()):
            text += f"\n  FAILED {failed['test']}: {failed['why'].splitlines()[0]}"
        print(f"{group['group']}: {text}", flush=True)


def _why(group: dict[str, Any]) -> str:
    """Why there are no counts of a group, or nothing."""
    if "failure" not in group:
        return ""
    said = str(group.get("output", "")).strip().splitlines()
    return "; ".join([group["failure"], *said[-1:]])


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda:0", help="cpu: a trial without a GPU, to be had small")
    parser.add_argument("--json", help="file to write, after every step")
    parser.add_argument("--only", choices=("tests", "table"), help="one of the two; both otherwise")
    parser.add_argument("--seconds", type=float, default=560.0, help="everything ends within this time")
    parser.add_argument("--test-share", type=float, default=0.45, help="part of the time that tests may take")
    parser.add_argument("--jobs", type=int, default=4, help="groups of tests at a time")
    parser.add_argument("--groups", nargs="+", choices=list(GROUPS), default=list(GROUPS), metavar="GROUP")
    parser.add_argument(
        "--pytest", action="append", default=[], metavar="OPTION", help="for pytest: --pytest=-x; repeatable"
    )
    parser.add_argument("--scenes", nargs="+", default=list(_SCENES), metavar="NAME:TRIANGLES")
    parser.add_argument("--methods", nargs="+", default=methods(), choices=methods(), metavar="METHOD")
    parser.add_argument("--size", type=int, default=1024, help="image width and height [px]")
    parser.add_argument("--frames", type=int, default=40, help="frames per figure")
    parser.add_argument("--figure-seconds", type=float, default=1.0, help="seconds per figure")
    parser.add_argument("--modules", nargs="+", default=[], help="modules of kernels that are compiled first; all")
    parser.add_argument("--commit", help="where the checkout has no git history")
    return parser.parse_args(words)


def main() -> int:
    """Run everything; 1 if a test failed or a mask of ours was wrong or never came."""
    options = arguments()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runner = Runner(options, folder)
        runner.note(device=runner.step("device")[0])
        print(json.dumps(runner.found["machine"] | runner.found["device"]), flush=True)
        if "failure" in runner.found["device"]:
            return 1
        runner.note(modules=runner.step("modules", "--modules", *options.modules, limit=300.0))
        if options.only != "table":
            _tests(runner, options, folder)
        if options.only != "tests":
            runner.measure()
    runner.note(done=True)
    troubled = [row for row in runner.found.get("rows", []) if "failure" in row]
    failed = [group for group in runner.found.get("tests", []) if group.get("exit code") != 0]
    return int(bool(troubled or failed))


if __name__ == "__main__":
    sys.exit(main())
