# SPDX-License-Identifier: Apache-2.0
"""Kills what works on `shadow_tracer bags` at random moments and starts it again, until it is through; the output must
have the bytes of one uninterrupted run.

    python benchmark/bags_killed.py [--engine local|dask] [--kills 50] [--mesh-megabytes 100]
    python benchmark/bags_killed.py --bag IN [options of shadow_tracer bags, such as --param]

With ``--engine local`` the command is killed, or one of its worker processes; with ``dask`` the command, a worker or
the scheduler, separate processes on 127.0.0.1. The recording is made if none is given: 40 images, after a mesh of so
many megabytes, with markers that come and go. It is cut into 1, 7 and 40 windows.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from procedural import wavy_sheet
from recordings import Recorder
from rosbags.highlevel import AnyReader

from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import DELETE, MarkerMessage, encode_marker

PROGRAM = (sys.executable, "-m", "shadow_tracer.apps.cli")
IMAGES, SIZE = 40, (64, 48)
HERE = "127.0.0.1"
SELDOM = {  # as docs/fleet.md advises
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms", "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}  # fmt: skip
QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


def digest(bag: Path) -> str:
    """Of topics, times and bytes of all messages."""
    found = hashlib.sha256()
    with AnyReader([bag]) as reader:
        for connection, when, data in reader.messages():
            found.update(f"{connection.topic} {when} {len(data)} ".encode())
            found.update(data)
    return found.hexdigest()


def recording(path: Path, megabytes: float) -> list[str]:
    """Make the recording. Returns the options that go with it."""
    cells = max(2, int((megabytes * 1e6 / 48) ** 0.5))  # two triangles and a vertex each
    sheet, chance = wavy_sheet(cells, 0.0), np.random.default_rng(0)
    with Recorder(path, *SIZE) as recorder:
        recorder.write("/mesh", encode_mesh(*sheet), 0)
        for k in range(IMAGES):
            now = 1_000_000_000 + k * 66_000_000
            points = wavy_sheet(1, k)[0][:3] - (0.0, 0.0, 0.4)
            marker = MarkerMessage(id=k % 5, frame="camera", frame_locked=True, stamp=now, points=points)
            if k % 4 == 3:
                marker = MarkerMessage(id=k % 3, action=DELETE)
            recorder.write("/mesh_marker", encode_marker(marker), now)
            recorder.image(2500 + chance.integers(-3, 4, SIZE[::-1]), now + 10_000_000)
    values = {
        "device": "cpu", "light_names": "[lamp]", "lights.lamp.position": "[0.4, -0.3, 0.2]",
        "bounds.max_triangles": 2 * cells**2 + 64, "bounds.max_rays": SIZE[0] * SIZE[1], "bounds.max_lights": 1,
    }  # fmt: skip
    return [word for name, value in values.items() for word in ("--param", f"{name}:={value}")]


class Cluster:
    """A scheduler of Dask and two workers, each a process that may be killed and is started again."""

    def __init__(self) -> None:
        with socket.socket() as one:
            one.bind((HERE, 0))
            self._port = one.getsockname()[1]
        self.address = f"tcp://{HERE}:{self._port}"
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in ("scheduler", "worker 1", "worker 2"):
            self.start(name)

    def start(self, name: str) -> None:
        """Start one, or start it again."""
        module = "distributed.cli.dask_worker"
        arguments = [self.address, "--nthreads", "1", "--no-nanny", "--host", HERE, "--death-timeout", "120"]
        if name == "scheduler":
            module, arguments = "distributed.cli.dask_scheduler", ["--host", HERE, "--port", str(self._port)]
        command = [sys.executable, "-m", module, *arguments, "--no-dashboard"]
        self._processes[name] = subprocess.Popen(command, env={**os.environ, **SELDOM}, **QUIET)

    @property
    def names(self) -> list[str]:
        """What can be killed."""
        return list(self._processes)

    def kill(self, name: str) -> None:
        """Kill one, and start it again."""
        self._processes[name].kill()
        self._processes[name].wait()
        self.start(name)

    def wait(self, workers: int) -> None:
        """Wait until so many workers stand ready."""
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)

    @property
    def processor_seconds(self) -> float:
        """What all of them have taken, those that were killed aside."""
        rows = [
            Path(f"/proc/{each.pid}/stat").read_text().rpartition(")")[2].split() for each in self._processes.values()
        ]
        return sum(int(row[11]) + int(row[12]) for row in rows) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        """End all of them."""
        for process in self._processes.values():
            process.kill()
            process.wait()


def children(pid: int) -> list[int]:
    """Worker processes of a command; not the one by which Python keeps track of what they share."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = (entry / "stat").read_text().rpartition(")")[2].split()[1]
            if int(parent) == pid and b"spawn_main" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
    return found


class Run:
    """The command, which goes on until it is through, however often it is killed."""

    def __init__(self, command: list[str], out: Path, chance: random.Random) -> None:
        self._command, self._out, self._chance = command, out, chance
        self.ends: Counter[int] = Counter()
        self._process = subprocess.Popen(command, **QUIET)

    def go_on(self) -> None:
        """Start it again if it is through; some parts are lost, so that there is work."""
        code = self._process.poll()
        if code is None:
            return
        self.ends[code] += 1
        for part in self._out.glob("*/*.mcap"):
            if self._chance.random() < 0.4:
                part.unlink()
        self._process = subprocess.Popen(self._command, **QUIET)

    def kill(self, worker: bool) -> str:
        """Kill the command, or one of its workers some time after there are any. Returns which it was."""
        end = time.monotonic() + 60.0
        while worker and not children(self._process.pid) and self._process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        if worker:
            time.sleep(self._chance.uniform(0.0, 4.0))
        workers = children(self._process.pid) if worker else []
        victim = self._chance.choice(workers) if workers else self._process.pid
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        return "a worker" if workers else "the command"

    def finish(self) -> None:
        """Let it come to its end, and then once more, which has nothing to do or what is left. Raises
        CalledProcessError."""
        self._process.wait()
        subprocess.run(self._command, check=True, **QUIET)


@contextlib.contextmanager
def cluster_of(engine: str) -> Iterator[Cluster | None]:
    """A cluster, if the engine wants one."""
    found = Cluster() if engine == "dask" else None
    try:
        yield found
    finally:
        if found is not None:
            found.close()


def killed(command: list[str], out: Path, kills: int, chosen: argparse.Namespace, chance: random.Random) -> Run:
    """Run a command to its end with so many kills."""
    with cluster_of(chosen.engine) as cluster:
        if cluster is not None:
            command = [*command, "--engine", "dask", "--scheduler", cluster.address]
        run, victims = Run(command, out, chance), Counter[str]()
        for _ in range(kills):
            time.sleep(chance.uniform(0.0, chosen.longest))
            run.go_on()
            victim = chance.choice(["the command", *(cluster.names if cluster is not None else ["a worker"])])
            if cluster is not None and victim in cluster.names:
                cluster.kill(victim)
            else:
                victim = run.kill(victim == "a worker")
            victims[victim] += 1
            print(f"killed {victim}: {len([*out.glob('*/*.mcap')])} parts", flush=True)
        run.finish()
    print(f"killed: {dict(victims)}; exit codes of the command: {dict(run.ends)}", flush=True)
    return run


def main(arguments: list[str] | None = None) -> int:
    """Returns 0 if the bytes are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bag", type=Path, metavar="IN")
    parser.add_argument("--mesh-megabytes", type=float, default=0.5)
    parser.add_argument("--engine", choices=("local", "dask"), default="local")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--frames", type=int, nargs="+", default=[40, 6, 1], help="of a window; kills are shared out")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--longest", type=float, default=6.0, help="seconds between two kills, at most")
    parser.add_argument("--seed", type=int, default=1)
    chosen, options = parser.parse_known_args(arguments)
    chance, wrong = random.Random(chosen.seed), 0
    with tempfile.TemporaryDirectory() as folder:
        bag, whole = chosen.bag or Path(folder) / "in", Path(folder) / "whole.mcap"
        if chosen.bag is None:
            options += recording(bag, chosen.mesh_megabytes)
        subprocess.run([*PROGRAM, "bag", str(bag), str(whole), "--no-timing", *options], check=True, **QUIET)
        for number, frames in enumerate(chosen.frames):
            out = Path(folder) / f"by {frames}"
            command = [*PROGRAM, "bags", str(bag), str(out), "--no-timing", *options, "--log-json"]
            command += ["--frames", str(frames), "--jobs", str(chosen.jobs)]
            share: Any = chosen.kills * (number + 1) // len(chosen.frames) - chosen.kills * number // len(chosen.frames)
            killed(command, out, share, chosen, chance)
            same = digest(whole) == digest(next(out.glob("*/metadata.yaml")).parent)
            left = [path.name for path in out.glob("*/.*") if path.is_dir() or path.suffix == ".part"]
            print(f"windows of {frames}: the bytes are {'the same' if same else 'OTHERS'}; left behind: {left or '-'}")
            wrong += not same or bool(left)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
