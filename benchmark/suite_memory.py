# SPDX-License-Identifier: Apache-2.0
"""Section "memory": what each pipeline and peer holds, each in a process of its own that traces a few frames and
reports its highest resident memory.

Run as a program it is that process: ``suite_memory.py FILE NAME``, FILE being a case that the parent has saved.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from suite_settings import Clock, Rows, Settings

from shadow_tracer.gpu.device.devices import pick_device

_MEGA = 1e-6
_PEERS = ("wp.Mesh", "Embree")
_FRAMES = 3


def memory(settings: Settings, clock: Clock) -> Rows:
    """The first of the few views: the pipelines, the peers, then every other variant."""
    from case import Case, LightRays
    from rivals import missing
    from scenes import views

    rows: Rows = []
    first = ["/".join(pair) for pair in settings.pipelines]
    others = ["/".join(pair) for pair in settings.held if "/".join(pair) not in first]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "case.npz"
        for view in views(settings.size, list(settings.views_few[:1])):
            case = Case(view, 1)
            rays: LightRays = case.frames[0].lights[0]
            shot = case.frames[0].shot
            np.savez(
                file,
                vertices=view.positions[0],
                triangles=view.triangles,
                depth=shot.depth,
                focal=[shot.camera.fx, shot.camera.fy, shot.camera.cx, shot.camera.cy],
                pose=shot.camera.camera_to_world,
                light=view.light.homogeneous,
                bias=view.bias,
                starts=rays.starts,
                ways=rays.ways,
                reach=rays.reach,
                answer=case.static[0][0],
            )
            for name in [*first, *(peer for peer in _PEERS if peer not in missing()), *others]:
                if clock.allows(name):
                    rows += _child(file, name, view.name, case)
    return rows


def _child(file: Path, name: str, view: str, case: Any) -> Rows:
    done = subprocess.run(
        [sys.executable, __file__, str(file), name], capture_output=True, text=True, timeout=600, check=False
    )
    if done.returncode:
        raise SystemExit(f"memory of {name}: the process failed\n{done.stderr}")
    shared = {"view": view, "triangles": len(case.view.triangles), "rays": case.rays}
    return [{**shared, "method": name, **json.loads(done.stdout.splitlines()[-1])}]


def _resident(field: str) -> float:
    """Megabytes of VmRSS (now) or VmHWM (the most ever; unlike ru_maxrss it does not begin with the parent's)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field):
            return 1024.0 * float(line.split()[1]) * _MEGA
    raise SystemExit(f"/proc/self/status has no {field}")


def _ours(file: Any, pipeline: str, variant: str) -> dict[str, Any]:
    from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer, State

    depth, triangles = file["depth"], file["triangles"]
    camera = Camera(depth.shape[1], depth.shape[0], *file["focal"], file["pose"])
    light = PointLight("lamp", file["light"][:3] / file["light"][3])
    loaded = _resident("VmRSS")
    tracer = ShadowTracer(pipeline, variant, "cpu", Bounds(max_triangles=len(triangles), max_rays=depth.size))
    tracer.scene.put("mesh", file["vertices"], triangles)
    brute = pipeline == "brute_force"
    for _ in range(1 if brute else _FRAMES):
        tracer.scene.deform("mesh", file["vertices"])
        if brute:  # all rays would take a minute, and no more memory
            depth = np.where(np.arange(depth.size).reshape(depth.shape) % 1009 == 0, depth, 0.0).astype(depth.dtype)
        frame = tracer.trace(depth, camera, [light], bias=float(file["bias"]))
    valid = np.isfinite(file["depth"]).ravel() & (file["depth"] > 0).ravel()
    found = (frame.state("lamp").ravel() == State.SHADOWED)[valid]
    asked = (frame.state("lamp").ravel() != State.INVALID)[valid]
    if not np.array_equal(found[asked], file["answer"][asked]):
        raise SystemExit(f"{pipeline}/{variant} is wrong")
    return {"device MB": tracer.device_bytes * _MEGA, "loaded MB": loaded, "peak MB": _resident("VmHWM")}


def _peer(file: Any, name: str) -> dict[str, Any]:
    from case import LightRays
    from rivals import Embree, WarpMesh

    rays = LightRays(file["starts"], file["ways"], file["reach"])
    frame = SimpleNamespace(lights=[rays], points=rays.starts)
    view = SimpleNamespace(positions=file["vertices"][None], triangles=file["triangles"])
    case: Any = SimpleNamespace(view=view, frames=[frame], lights=[None], rays=len(rays.starts))
    loaded = _resident("VmRSS")
    peer = Embree(case) if name == "Embree" else WarpMesh(case, build=True)
    for _ in range(_FRAMES):
        found = peer.dynamic(0)
    wrong = int((found[0] != file["answer"]).sum())
    if wrong > 1e-3 * len(rays.starts):
        raise SystemExit(f"{name} is wrong for {wrong} rays")
    return {"device MB": None, "loaded MB": loaded, "peak MB": _resident("VmHWM")}


def main() -> None:
    """The process: one line of JSON."""
    path, name = sys.argv[1:]
    with np.load(path) as archive:
        file = {key: archive[key] for key in archive.files}
    pick_device("cpu")  # Warp is loaded before the first reading
    if "/" in name:
        found = _ours(file, *name.split("/"))
    else:
        found = _peer(file, name)
    print(json.dumps({**found, "more MB": found["peak MB"] - found["loaded MB"]}))


if __name__ == "__main__":
    main()
