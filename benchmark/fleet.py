# SPDX-License-Identifier: Apache-2.0
"""Seconds for each gigabyte of recording by one process and two, by processes and by Dask, and what planning takes.

The recording is made: 640 x 480 pixels of 16 bits with noise, and with each image a mesh of 20,000 triangles that has
moved. Runs are taken in turn, ``--rounds`` times, and their medians printed; no time is printed for an output that was
not compared with that of ``shadow_tracer bag``. Wall time is what counts where the machine is idle; processor time is
that of all processes of a run, and shows on a busy one what is spent beside the work.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bags_killed import PROGRAM, Cluster, digest
from procedural import wavy_sheet
from recordings import Recorder
from report import finish

from shadow_tracer.apps.bag.reader import Recording
from shadow_tracer.apps.bag.survey import survey
from shadow_tracer.apps.bags.jobs import Options
from shadow_tracer.ros.wire.cdr import encode_mesh

WIDTH, HEIGHT, RATE = 640, 480, 15.0
CELLS, PHASES = 100, 40  # of a mesh, and meshes in turn
PARAMETERS = {
    "device": "cpu", "light_names": ["lamp"], "lights.lamp.position": [0.4, -0.3, 0.2], "pose_source": "parameter",
    "bounds.max_triangles": 20_000, "bounds.max_rays": WIDTH * HEIGHT, "bounds.max_lights": 1,
}  # fmt: skip


def record(path: Path, size: float, compressed: bool) -> int:
    """Write so many bytes of messages. Returns how many images that are."""
    meshes = [encode_mesh(*wavy_sheet(CELLS, 2 * np.pi * n / PHASES)) for n in range(PHASES)]
    noise, number = np.random.default_rng(0), 0
    depths = [2500 + noise.integers(-3, 4, (HEIGHT, WIDTH)) for _ in range(7)]
    with Recorder(path, WIDTH, HEIGHT, compressed) as recorder:
        while recorder.written < size:
            now = 10**12 + round(number * 1e9 / RATE)
            depth = depths[number % len(depths)].copy()
            depth[number % HEIGHT, ::41] = 0
            recorder.write("/mesh", meshes[number % PHASES], now)
            recorder.image(depth, now + 1_000_000)
            number += 1
    return number


def given() -> list[str]:
    """The parameters, as options."""
    texts = {name: f"[{', '.join(map(str, v))}]" if isinstance(v, list) else v for name, v in PARAMETERS.items()}
    return [word for name, text in texts.items() for word in ("--param", f"{name}:={text}")]


def timed(command: list[str]) -> tuple[float, float]:
    """Wall and processor seconds of a command and all that it starts. Raises CalledProcessError."""
    begin, before = time.monotonic(), os.times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = os.times()
    spent = sum(getattr(after, name) - getattr(before, name) for name in ("children_user", "children_system"))
    return time.monotonic() - begin, spent


def by_cluster(command: list[str]) -> tuple[float, float]:
    """The same of a command that wants the address of a scheduler, with a scheduler and two workers of their own, which
    stand ready."""
    cluster = Cluster()
    try:
        cluster.wait(2)
        before = cluster.processor_seconds
        wall, spent = timed([*PROGRAM, *command, cluster.address])
        return wall, spent + cluster.processor_seconds - before
    finally:
        cluster.close()


def planning(bag: Path) -> float:
    """Processor seconds of a plan, the least of three."""
    options, spent = Options("/shadow_tracer", [], dict(PARAMETERS), "", {}, 1), []
    for _ in range(3):
        begin = time.process_time()
        with Recording(bag, options.names, ["lamp"], WIDTH * HEIGHT) as recording:
            survey(recording, options.settings)
        spent.append(time.process_time() - begin)
    return min(spent)


def main() -> int:
    """Measure and print a table. Returns 1 if an output is another."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--compressed", action="store_true", help="chunks by zstd")
    parser.add_argument("--frames", type=int, default=100, help="of a window")
    parser.add_argument("--cases", type=int, nargs="*", default=[0, 1, 2, 3], help="numbers from 0")
    parser.add_argument("--json", help="file to write")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag, out = Path(folder) / "bag", Path(folder) / "out"
        images = record(bag, chosen.gigabytes * 1e9, chosen.compressed)
        common = ["--no-timing", *given()]
        engine = [str(bag), str(out), *common, "--frames", str(chosen.frames), "--threads", "1"]
        cases = {
            "bag": ["bag", str(bag), str(out), *common, "--param", "threads:=1"],
            **{f"bags --jobs {jobs}": ["bags", *engine, "--jobs", str(jobs)] for jobs in (1, 2)},
            "bags --engine dask": ["bags", *engine, "--engine", "dask", "--scheduler"],
        }
        cases = {name: command for number, (name, command) in enumerate(cases.items()) if number in chosen.cases}
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
        answers = set()
        for _ in range(chosen.rounds):
            for name, command in cases.items():
                found[name].append(by_cluster(command) if "dask" in command else timed([*PROGRAM, *command]))
                answers.add(digest(out / "bag" if command[0] == "bags" else out))
                shutil.rmtree(out)
                print(name, found[name][-1], flush=True)
        plan = planning(bag)
        size = sum(file.stat().st_size for file in bag.iterdir()) / 1e9
    if len(answers) > 1:
        print("outputs differ", file=sys.stderr)
        return 1
    walls, spent = ({name: float(np.median([row[k] for row in rows])) for name, rows in found.items()} for k in (0, 1))
    one = "bags --jobs 1"
    rows = [
        {
            "run": name,
            "wall [s]": walls[name],
            "wall [s/GB]": walls[name] / chosen.gigabytes,
            "processor [s]": spent[name],
            "processor [s/GB]": spent[name] / chosen.gigabytes,
            "efficiency": walls.get(one, np.nan) / walls[name] / (1 if name in ("bag", one) else 2),
            "efficiency by processor": spent.get(one, np.nan) / spent[name],
            "planning, of processor [%]": 100.0 * plan / spent[name],
        }
        for name in cases
    ]
    title = f"{images} images, {chosen.gigabytes:g} GB of messages, {size:.2f} GB of files, plan {plan:.2f} s; "
    finish(f"{title}load {os.getloadavg()[0]:.1f}", rows, chosen.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
