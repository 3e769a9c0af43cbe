# SPDX-License-Identifier: Apache-2.0
"""One step of ``gpu_runner.py``, in a process of its own: an error on a GPU ends its process, and no other.

Figures are appended to a file, a line of JSON each, as soon as they are there. A time is written only for frames whose
masks were compared, every one of them, outside the clock.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import procedural
import warp as wp
from case import Case, hidden
from gpu_peers import PEERS, Peer
from kernel_resources import modules, warp_module
from scenes import View

from shadow_tracer import ShadowTracer
from shadow_tracer.gpu.device.devices import pick_device
from shadow_tracer.gpu.device.stages import Stages

_WARM_UP = 4  # frames: the first launches, the second records, and all caches have been filled
_TOO_MANY_PAIRS = {"cpu": 2e9, "cuda": 2e11}  # for brute force: a few seconds
_TRANSFERS = ("upload", "download")
_MOST_WRONG = 1e-3  # part of the rays; peers work in float32
_VIEWS = {"robots": ("corridor", "inside"), "museum": ("room", "inside"), "stadium": ("pot", "inside")}


def make_case(scene: str, triangles: int, size: int) -> Case:
    """Four frames of a scene made by code, and the answers: mesh_bvh on the CPU, brute_force on a subset."""
    made = procedural.SCENES[scene](triangles, frames=4)
    eye, light = (getattr(made, what)[name] for what, name in zip(("eyes", "lights"), _VIEWS[scene], strict=True))
    name = f"{scene} {len(made.triangles):,}"
    return Case(View(name, made.positions, made.triangles, eye.camera(size), light, 0.01, eye.pixels(size)), 4)


class Clock:
    """Wall time and, on CUDA, the time between two events around a step."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._events = [wp.Event(device, enable_timing=True) for _ in range(2)] if device.is_cuda else []

    def time(self, step: Callable[[], Any]) -> tuple[Any, float, float]:
        """What ``step`` returns, milliseconds of the host (device included), and of the device (the host's on the
        CPU)."""
        wp.synchronize_device(self._device)
        begin = time.perf_counter()
        for event in self._events[:1]:
            wp.get_stream(self._device).record_event(event)
        result = step()
        for event in self._events[1:]:
            wp.get_stream(self._device).record_event(event)
        wp.synchronize_device(self._device)
        wall = 1e3 * (time.perf_counter() - begin)
        return result, wall, float(wp.get_event_elapsed_time(*self._events)) if self._events else wall


@contextmanager
def counted() -> Iterator[dict[str, int]]:
    """Counts what is launched from Python inside: kernels, and whatever else the device is asked to do."""
    counts: dict[str, int] = {"kernels": 0, "other": 0}
    places = [(wp, "launch", "kernels"), (wp.Launch, "launch", "kernels"), (wp, "copy", "other")]
    places += [(wp.utils, name, "other") for name in ("array_scan", "radix_sort_pairs")]
    places += [(wp.array, name, "other") for name in ("zero_", "fill_")]
    kept = [getattr(place, name) for place, name, _ in places]

    def counting(function: Callable[..., Any], kind: str) -> Callable[..., Any]:
        def call(*inputs: Any, **options: Any) -> Any:
            counts[kind] += not options.get("record_cmd", False)
            return function(*inputs, **options)

        return call

    for (place, name, kind), function in zip(places, kept, strict=True):
        setattr(place, name, counting(function, kind))
    try:
        yield counts
    finally:
        for (place, name, _), function in zip(places, kept, strict=True):
            setattr(place, name, function)


def profile(step: Callable[[], Any], device: Any) -> dict[str, Any]:
    """What one run of ``step`` launches; on CUDA also the milliseconds of each kernel and copy, by name."""
    with counted() as counts:
        step()
    found: dict[str, Any] = {"launched": dict(counts)}
    if device.is_cuda:
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        step()
        activities: dict[str, list[float]] = {}
        for result in wp.timing_end():
            activities.setdefault(result.name, []).append(result.elapsed)
        found["activities"] = {name: {"count": len(ms), "ms": sum(ms)} for name, ms in activities.items()}
    return found


class Entry:
    """Somebody who takes part.

    Attributes:
        mesh: whether it is moving or resting; new rays in every frame.
        most_wrong: pixels of a frame that may differ.
    """

    mesh = "moving"
    most_wrong = 0.0

    def prepare(self, frame: int) -> None:
        """What is to be done before a frame, not timed."""

    def step(self, frame: int) -> Any:
        """The frame, numpy to numpy: timed."""
        raise NotImplementedError

    def stages(self) -> dict[str, float]:
        """Milliseconds of the parts of the last frame: ``upload`` and ``download`` are transfers, all else is work."""
        raise NotImplementedError

    def wrong(self, frame: int, found: Any) -> int:
        """In how many pixels what ``step`` returned differs from the right answer."""
        raise NotImplementedError


class Ours(Entry):
    """A variant of a pipeline, launched one by one or as a recording."""

    def __init__(self, case: Case, method: str, device: Any, graphs: bool) -> None:
        self._case, self._positions = case, case.view.positions
        pipeline, variant = method.split("/")
        self.tracer = ShadowTracer(pipeline, variant, str(device), case.bounds(), graphs=graphs)
        self.tracer.scene.put("mesh", self._positions[0], case.view.triangles)

    def rest(self) -> None:
        """From now on the mesh stays as it is in frame 0."""
        self.mesh = "resting"
        self.tracer.scene.deform("mesh", self._positions[0])

    def step(self, frame: int) -> Any:
        if self.mesh == "moving":
            self.tracer.scene.deform("mesh", self._positions[frame])
        shot = self._case.frames[frame].shot
        self.last = self.tracer.trace(shot.depth, shot.camera, self._case.lights, bias=self._case.view.bias)
        for light in self._case.lights:
            self.last.mask(light.name)  # a GPU's states come packed: to have an image belongs to the frame
        return self.last

    def stages(self) -> dict[str, float]:
        return dict(self.last.stages)

    def wrong(self, frame: int, found: Any) -> int:
        answers = self._case.dynamic if self.mesh == "moving" else self._case.static
        return int((hidden(found, self._case.lights, self._case.frames[frame]) != answers[frame]).sum())


class Theirs(Entry):
    """A peer. Its rays lie on the device before the clock starts."""

    def __init__(self, case: Case, peer: Peer, device: Any) -> None:
        self._case, self._peer, self._stages = case, peer, Stages(device)
        self.most_wrong = _MOST_WRONG * case.rays
        self.graph: Any = None

    def record(self) -> None:
        """From now on, structure and query are one recording."""
        with wp.ScopedCapture(device=self._peer.device, force_module_load=False) as capture:
            self._peer.structure()
            self._peer.query()
        self.graph = capture.graph

    def prepare(self, frame: int) -> None:
        self._peer.take_rays(frame)

    def step(self, frame: int) -> Any:
        stage = self._stages.stage
        self._stages.reset()
        with stage("upload"):
            self._peer.upload(frame)
        if self.graph is not None:
            with stage("graph"):
                wp.capture_launch(self.graph)
        else:
            with stage("structure"):
                self._peer.structure()
            with stage("query"):
                self._peer.query()
        with stage("download"):
            return self._peer.answer(frame)

    def stages(self) -> dict[str, float]:
        return self._stages.read()

    def wrong(self, frame: int, found: Any) -> int:
        return int((found != self._case.dynamic[frame][0]).sum())


class Figures:
    """Frames of an entry."""

    def __init__(self, case: Case, device: Any, frames: int, seconds: float) -> None:
        self.case, self.device = case, device
        self._frames, self._seconds = frames, seconds
        self._clock = Clock(device)
        self._used = _used(device)

    def run(self, entry: Entry) -> dict[str, Any]:
        """Frames 0, 1, 2, 3, 0, ...: a row of times, or of why there are none."""
        walls: list[float] = []
        events: list[float] = []
        stages: list[dict[str, float]] = []
        worst, spent = 0, 0.0
        for k in range(_WARM_UP + self._frames):
            frame = k % len(self.case.frames)
            entry.prepare(frame)
            found, wall, event = self._clock.time(partial(entry.step, frame))
            worst = max(worst, entry.wrong(frame, found))
            if worst > entry.most_wrong:
                return {"failure": f"{worst} wrong pixels in frame {frame}: no times are given", "wrong": worst}
            spent += wall / 1e3
            if k >= _WARM_UP or spent > self._seconds:
                walls.append(wall)
                events.append(event)
                stages.append(entry.stages())
            if spent > self._seconds and len(walls) >= min(3, self._frames):
                break
        work = [sum(ms for name, ms in each.items() if name not in _TRANSFERS) for each in stages]
        row = {
            "mesh": entry.mesh,
            "graph": "graph" in stages[-1],
            "device ms": _three(work),
            "events ms": _three(events),
            "wall ms": _three(walls),
            "stages ms": {name: float(np.median([each.get(name, 0.0) for each in stages])) for name in stages[-1]},
            "frames": len(walls),
            "wrong": worst,
        }
        if self.device.is_cuda:
            row["memory taken"] = _used(self.device) - self._used
        return row


def _used(device: Any) -> int:
    """Bytes in use on a CUDA device: of Warp's pool if it has one."""
    if not device.is_cuda:
        return 0
    if wp.is_mempool_enabled(device):
        return int(wp.get_mempool_used_mem_current(device))
    return int(device.total_memory - device.free_memory)


def _three(values: list[float]) -> dict[str, float]:
    return {"median": float(np.median(values)), "least": min(values), "p95": float(np.percentile(values, 95))}


def measure_ours(figures: Figures, method: str) -> Iterator[dict[str, Any]]:
    """Rows of a pipeline's variant: launched one by one and, if it can be, recorded; mesh moving and resting."""
    case, device = figures.case, figures.device
    pairs = case.rays * len(case.view.triangles)
    if method.startswith("brute_force") and pairs > _TOO_MANY_PAIRS["cuda" if device.is_cuda else "cpu"]:
        yield {"skipped": f"{pairs:.0e} pairs of rays and triangles take too long"}
        return
    for graphs in (False, True):
        entry = Ours(case, method, device, graphs)
        for rest in (False, True):
            if rest:
                entry.rest()
            row = figures.run(entry)
            if graphs and not row.get("graph", True):
                return  # it cannot be recorded: nothing new
            if "failure" not in row:
                row |= {"counters": entry.last.counters, "device bytes": entry.tracer.device_bytes}
                if not graphs:
                    row |= profile(partial(entry.step, 1), device)
            yield {"mesh": entry.mesh, "graph": graphs, **row}


def measure_peer(figures: Figures, method: str) -> Iterator[dict[str, Any]]:
    """Rows of a peer: launched one by one, and on CUDA recorded if it can be."""
    case, device = figures.case, figures.device
    peer = PEERS[method](case, device)
    entry = Theirs(case, peer, device)
    row = figures.run(entry)
    if "failure" not in row:
        row |= profile(partial(entry.step, 1), device)
    yield row
    if peer.recordable and device.is_cuda:  # on the CPU refitting a wp.Mesh is not recorded
        entry.record()
        yield {"graph": True, **figures.run(entry)}


def load_modules(device: Any, chosen: list[str]) -> Iterator[dict[str, Any]]:
    """Compile or load modules of kernels, all if none are chosen; what their kernels take on this device."""
    for name in chosen or modules():
        begin = time.perf_counter()
        try:
            module = warp_module(name)
            module.load(device)
            row: dict[str, Any] = {"module": name, "seconds": time.perf_counter() - begin}
            if device.is_cuda:
                kernels = [each for each in module.kernels.values() if not each.is_generic]
                row["kernels"] = {each.key: wp.get_cuda_kernel_properties(each, device) for each in kernels}
        except Exception:
            row = {"module": name, "failure": traceback.format_exc()[-1500:]}
        yield row


def describe(device: Any) -> dict[str, Any]:
    """The device and Warp."""
    found: dict[str, Any] = {"device": str(device), "name": device.name, "warp": wp.config.version}
    if device.is_cuda:
        found |= {
            "arch": device.arch,
            "multiprocessors": device.sm_count,
            "memory bytes": device.total_memory,
            "driver": ".".join(map(str, wp.get_cuda_driver_version())),
            "toolkit": ".".join(map(str, wp.get_cuda_toolkit_version())),
        }
    return found


def rows(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """What the command line asks for, as it comes."""
    if options.step == "case":
        scene, triangles = options.scene.split(":")
        case = make_case(scene, int(triangles), options.size)
        Path(options.case).write_bytes(pickle.dumps(case, pickle.HIGHEST_PROTOCOL))
        yield {"scene": case.view.name, "rays": case.rays, "in shadow": case.in_shadow}
        return
    device = pick_device(options.device)
    if options.step == "device":
        yield describe(device)
    elif options.step == "modules":
        yield from load_modules(device, options.modules)
    else:
        # A case that this very program has written a moment ago.
        case = pickle.loads(Path(options.case).read_bytes())
        about = {"scene": case.view.name, "triangles": len(case.view.triangles), "rays": case.rays}
        figures = Figures(case, device, options.frames, options.seconds)
        measure = measure_peer if options.method in PEERS else measure_ours
        for row in measure(figures, options.method):
            yield {**about, "method": options.method, **row}


def main() -> None:
    """Do one step; its rows go to a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("device", "modules", "case", "measure"))
    parser.add_argument("--rows", required=True, help="file that lines of JSON are appended to")
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--modules", nargs="*", default=[], help="for step modules: which, all by default")
    parser.add_argument("--scene", help="for step case: name:triangles")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--case", help="file of the case")
    parser.add_argument("--method", help="pipeline/variant, or a peer")
    parser.add_argument("--frames", type=int, default=40, help="frames per figure")
    parser.add_argument("--seconds", type=float, default=2.0, help="seconds per figure")
    options = parser.parse_args()
    with open(options.rows, "a") as file:
        for row in rows(options):
            file.write(json.dumps(row) + "\n")
            file.flush()


if __name__ == "__main__":
    main()
