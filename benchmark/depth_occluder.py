# SPDX-License-Identifier: Apache-2.0
"""A depth image as its own occluder: 640 x 480 at full resolution, another image in every frame, beside a frame of a
mesh of 70,000 triangles that deforms.

Images are recorded ones; a lamp stands beside the camera. Whatever is measured is asked in turn, by one thread, and a
time is the processor time of the thread, numpy to numpy, ``put_depth`` (or ``deform``) and ``trace`` together. No time
is printed for a frame that was not compared: with ``light_grid`` in every pixel, and with ``brute_force`` in some.

Data: recordings ``livingroom1`` and ``redkitchen`` and the mesh ``bart_robots_t10``, in ``SHADOW_TRACER_DATA`` or
``../shared/data``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from case import shots
from report import header, note, table, threads, write_json
from scenes import Shot, data_folder, recorded_shot, views

from shadow_tracer import Bounds, DirectionalLight, PointLight, ShadowTracer, State

_RECORDED = {"livingroom1": (0, 10, 20, 30), "redkitchen": (0, 50)}
_AWAY = (1.0, 0.3)  # of the lamp from the camera, to its side [m]
_BIAS = 0.02
_JUMP = 0.05
_COUNTED = ("nodes_visited", "leaf_tests", "retested", "exact")


def _lights(shot: Shot) -> dict[str, PointLight | DirectionalLight]:
    """Lamps beside the camera, one behind it, and the sun over its shoulder."""
    pose = shot.camera.camera_to_world
    beside = {f"lamp {away:g} m beside": np.array([away, 0.0, 0.0]) for away in _AWAY}
    places = {**beside, "lamp 1 m behind, 0.5 m above": np.array([0.0, -0.5, -1.0])}
    found: dict[str, PointLight | DirectionalLight] = {
        name: PointLight("light", pose[:3, :3] @ place + pose[:3, 3]) for name, place in places.items()
    }
    found["sun from the upper left"] = DirectionalLight("light", pose[:3, :3] @ np.array([0.5, 0.7, 1.0]))
    return found


class DepthFrames:
    """Frames of a recording, each its own occluder, by a pipeline."""

    def __init__(self, pipeline: str, recorded: list[Shot], light: str) -> None:
        pixels = recorded[0].depth.size
        bounds = Bounds(max_triangles=2 * pixels, max_rays=pixels)
        self.tracer = ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=1)
        self._recorded, self._light = recorded, light

    def __call__(self, number: int) -> Any:
        """Trace a frame."""
        shot = self._recorded[number % len(self._recorded)]
        self.tracer.scene.put_depth("depth", shot.depth, shot.camera, 1, _JUMP)
        return self.tracer.trace(shot.depth, shot.camera, [_lights(shot)[self._light]], _BIAS)


class MeshFrames:
    """Frames of a mesh that deforms, at the size of a depth image."""

    def __init__(self) -> None:
        self._view = next(views(640, ["BART robots"]))
        self._shots = [
            Shot(shot.depth[80:560], _cropped(shot)) for shot in shots(self._view, len(self._view.positions))
        ]
        bounds = Bounds(max_triangles=len(self._view.triangles), max_rays=640 * 480)
        self.tracer = ShadowTracer("light_grid", device="cpu", bounds=bounds, threads=1)
        self.tracer.scene.put("mesh", self._view.positions[0], self._view.triangles)
        self.triangles = len(self._view.triangles)

    def __call__(self, number: int) -> Any:
        """Trace a frame."""
        view, shot = self._view, self._shots[number % len(self._shots)]
        self.tracer.scene.deform("mesh", view.positions[number % len(view.positions)])
        return self.tracer.trace(shot.depth, shot.camera, [view.light], view.bias)


def _cropped(shot: Shot) -> Any:
    from shadow_tracer import Camera

    camera = shot.camera
    return Camera(640, 480, camera.fx, camera.fy, camera.cx, camera.cy - 80, camera.camera_to_world)


def _timed(use: Callable[[int], Any], number: int) -> tuple[float, Any]:
    begin = time.thread_time()
    frame = use(number)
    return (time.thread_time() - begin) * 1e3, frame


def _compare(methods: dict[str, DepthFrames], recorded: list[Shot], light: str, subset: int) -> float:
    """Raises if anything differs; returns how much is in shadow."""
    rng, dark = np.random.default_rng(0), []
    oracle = None
    for number, shot in enumerate(recorded):
        frames = {name: use(number) for name, use in methods.items()}
        first, second = frames.values()
        assert first.differing(second) == 0, f"{light}: differs in {first.differing(second)} pixels"
        state = second.state("light")
        known = np.flatnonzero((state == State.LIT) | (state == State.SHADOWED))
        dark.append(float((state.ravel()[known] == State.SHADOWED).mean()))
        if subset and number == 0:
            some = rng.choice(known, subset)
            oracle = ShadowTracer(
                "brute_force", device="cpu", bounds=Bounds(max_triangles=2 * shot.depth.size, max_rays=subset)
            )
            oracle.scene.put_depth("depth", shot.depth, shot.camera, 1, _JUMP)
            points = shot.camera.unproject(shot.depth / 1000.0).reshape(-1, 3)[some]
            expected = oracle.occluded(points, _lights(shot)[light], _BIAS)
            assert np.array_equal(expected, state.ravel()[some] == State.SHADOWED), "differs from brute_force"
    return float(np.mean(dark))


def measure(rounds: int, subset: int, sequences: list[str]) -> list[dict[str, Any]]:
    """A row for each recording and light."""
    folder, rows, mesh = data_folder(), [], MeshFrames()
    assert folder is not None, "no data folder (set SHADOW_TRACER_DATA)"
    for sequence in sequences:
        recorded = [recorded_shot(folder / "rgbd" / sequence, number, 1) for number in _RECORDED[sequence]]
        for light in _lights(recorded[0]):
            methods = {name: DepthFrames(name, recorded, light) for name in ("height_field", "light_grid")}
            dark = _compare(methods, recorded, light, subset)
            uses: dict[str, Callable[[int], Any]] = {**methods, "mesh": mesh}
            times: dict[str, list[float]] = {name: [] for name in uses}
            counts: dict[str, int] = {}
            for number in range(rounds):
                for name, use in uses.items():
                    took, frame = _timed(use, number)
                    times[name].append(took)
                    if name == "height_field":
                        counts = frame.counters
            median = {name: float(np.median(each)) for name, each in times.items()}
            rows.append(
                {
                    "recording": sequence,
                    "light": light,
                    "dark": dark,
                    **{f"{name} [ms]": each for name, each in median.items()},
                    "height_field / mesh": median["height_field"] / median["mesh"],
                    **{f"{key} a ray": counts[key] / recorded[0].depth.size for key in _COUNTED},
                }
            )
    note(f"mesh: light_grid, {mesh.triangles} triangles that deform, 640 x 480")
    return rows


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=24, help="frames of each (default: 24)")
    parser.add_argument("--subset", type=int, default=300, help="pixels that brute_force is asked about")
    parser.add_argument("--recordings", nargs="+", choices=list(_RECORDED), default=list(_RECORDED))
    parser.add_argument("--json", help="file for the figures")
    arguments = parser.parse_args()
    said = threads(1)
    title = "A depth image of 640 x 480 as its own occluder"
    header(title)
    note(said)
    rows = measure(arguments.rounds, arguments.subset, arguments.recordings)
    table(rows)
    write_json(title, rows, arguments.json)


if __name__ == "__main__":
    main()
