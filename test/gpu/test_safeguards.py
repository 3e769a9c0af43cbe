# SPDX-License-Identifier: Apache-2.0
"""Proof that the suite sees: each safeguard of the shadow test, taken away, makes scenes fail that the package passes.

The first mutants are written here in numpy, as one would write the test without the safeguards; the last two are
the package itself with one safeguard switched off.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import Bounds, PointLight, ShadowTracer

_ROOT = Path(__file__).resolve().parents[2]
Hides = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def _products(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, T) scalar products, added up from x to z: in the order of BLAS the last bits, and with them the leaks of a
    mutant, would hang on the processor."""
    x, y, z = (np.multiply.outer(points[:, k], normals[:, k]) for k in range(3))
    return x + y + z


def _product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(T,) scalar products of rows, added up from x to z."""
    x, y, z = (one[:, k] * other[:, k] for k in range(3))
    return x + y + z


def _hidden(points: np.ndarray, edges: list[np.ndarray], plane: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """All n.d >= 0 and N.d > D for any triangle, in the precision of the arrays; D made positive first."""
    sign = np.sign(depth)
    hidden = np.zeros(len(points), bool)
    for block in range(0, len(points), 512):
        d = points[block : block + 512]
        inside = (_products(d, plane * sign[:, None]) > depth * sign) & (sign != 0)
        for normal in edges:
            inside &= _products(d, normal * sign[:, None]) >= 0
        hidden[block : block + 512] = inside.any(axis=1)
    return hidden


def _plain_edges_float32(points: np.ndarray, light: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Edges a x b from light-relative corners rounded to float32; nothing re-tested."""
    a, b, c = ((corners[:, k] - light).astype(np.float32) for k in range(3))
    plane = np.cross(b - a, c - a)
    return _hidden(
        (points - light).astype(np.float32),
        [np.cross(a, b), np.cross(b, c), np.cross(c, a)],
        plane,
        _product(plane, a),
    )


def _edge_form_float32(points: np.ndarray, light: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Edges a x (b - a), made in float64 and rounded once, evaluated in float32: what is left without the exact
    decision."""
    a, b, c = (corners[:, k] - light for k in range(3))
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    edges = [
        np.cross(p, q)
        for p, q in (
            (a, corners[:, 1] - corners[:, 0]),
            (b, corners[:, 2] - corners[:, 1]),
            (c, corners[:, 0] - corners[:, 2]),
        )
    ]
    return _hidden(
        (points - light).astype(np.float32),
        [n.astype(np.float32) for n in edges],
        plane.astype(np.float32),
        _product(plane, a).astype(np.float32),
    )


def _plain_edges_float64(points: np.ndarray, light: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Edges a x b in float64, but not exact: good enough for pictures, not for vertices."""
    a, b, c = (corners[:, k] - light for k in range(3))
    plane = np.cross(b - a, c - a)
    return _hidden(points - light, [np.cross(a, b), np.cross(b, c), np.cross(c, a)], plane, _product(plane, a))


def _unflipped_normal(points: np.ndarray, light: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """D assumed positive: one of the two windings casts nothing, or from the wrong side."""
    a, b, c = (corners[:, k] - light for k in range(3))
    plane = np.cross(b - a, c - a)
    depth, d = _product(plane, a), points - light
    inside = _products(d, plane) > depth
    for normal in (np.cross(a, b - a), np.cross(b, c - b), np.cross(c, a - c)):
        inside &= _products(d, normal) >= 0
    return inside.any(axis=1)


_INSIDE = np.array([0.1, 0.2, 0.3])


@cache
def _sphere() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed, bumpy sphere around a light off its centre; samples behind all vertices and points of all edges. Made
    with + - * / sqrt: how many rays leak is the same on every machine."""
    vertices, triangles = geometry.icosphere(3, 1.0)
    vertices *= np.random.default_rng(122).integers(768, 1280, (len(vertices), 1)) / 1024.0
    targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles, (0.5, 0.3, 0.2))])
    return vertices, triangles, _INSIDE + 3.0 * (targets - _INSIDE)


@cache
def _far_light() -> tuple[np.ndarray, np.ndarray, np.ndarray, PointLight]:
    """Clutter of a few centimetres over a ground, one light ten kilometres away."""
    rng = np.random.default_rng(121)
    vertices, triangles = geometry.join([geometry.square(2, 0.0, 6.0), geometry.soup(rng, 1000, 0.04, 2.0)])
    vertices[4:, 2] += 2.5
    points = np.column_stack([rng.uniform(-3, 3, (2000, 2)), np.zeros(2000)])
    return vertices, triangles, points, PointLight("lamp", (3.0e3, 2.0e3, 9.0e3))


_LEAKY: dict[str, Hides] = {
    "plain edges, float32": _plain_edges_float32,
    "edge form, float32": _edge_form_float32,
    "plain edges, float64": _plain_edges_float64,
}


@pytest.mark.parametrize("mutant", _LEAKY)
def test_without_the_exact_decision_spheres_leak(mutant: str) -> None:
    vertices, triangles, samples = _sphere()
    leaks = int((~_LEAKY[mutant](samples, _INSIDE, vertices[triangles])).sum())
    assert leaks > 0, f"{mutant} passes the watertight scene: the scene is too kind"


def test_plain_edges_in_float32_fail_under_a_far_light() -> None:
    vertices, triangles, points, light = _far_light()
    expected = oracle.occluded(points, light, vertices, triangles).hidden
    wrong = _plain_edges_float32(points, light.position, vertices[triangles]) != expected
    assert wrong.mean() > 0.01, f"{wrong.sum()} wrong"
    assert 0.02 < expected.mean() < 0.95


def test_unflipped_normals_fail_on_one_winding() -> None:
    vertices, triangles = geometry.square(2, 0.0, 1.0)
    point, light = np.array([[0.25, 0.5, -1.0]]), np.array([0.0, 0.0, 2.0])
    answers = [bool(_unflipped_normal(point, light, vertices[t])[0]) for t in (triangles, triangles[:, ::-1])]
    assert answers[0] != answers[1]


def test_the_package_passes_the_same_scenes(tracer: Any) -> None:
    vertices, triangles, samples = _sphere()
    step = 1 if tracer.variant != "float64" else 20
    tracer.scene.put("mesh", vertices, triangles)
    assert tracer.occluded(samples[::step], PointLight("lamp", _INSIDE)).all()
    vertices, triangles, points, light = _far_light()
    tracer.scene.put("mesh", vertices, triangles)
    np.testing.assert_array_equal(
        tracer.occluded(points[::step], light), oracle.occluded(points, light, vertices, triangles).hidden[::step]
    )


@pytest.mark.parametrize("pipeline", ["brute_force", "mesh_bvh"])
def test_a_filter_that_is_always_sure_leaks(any_device: str, pipeline: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package with the float32 rounding bound of its filter set to nothing: hardly anything is re-tested, and
    the sphere leaks."""
    from shadow_tracer.gpu.occluders import seen

    vertices, triangles, samples = _sphere()

    def leaks() -> int:
        tracer = ShadowTracer(
            pipeline, device=any_device, bounds=Bounds(max_triangles=2000, max_rays=8000, queue_capacity=60_000)
        )
        tracer.scene.put("mesh", vertices, triangles)
        return int((~tracer.occluded(samples, PointLight("lamp", _INSIDE))).sum())

    assert leaks() == 0
    monkeypatch.setattr(seen, "FILTER_FACTOR", 0.0)
    assert leaks() > 0, "the watertight test does not notice a filter without a bound"


_MUTANT = """
import sys
sys.path[:0] = [{root!r}, {test!r}]
import numpy as np
from dataclasses import replace
from shadow_tracer.gpu.device import native
plain, name, sure = native.read, "exact/determinant.h", "if (absolute(value) > mul(least, permanent))"
text = plain(name).text
assert text.count(sure) == 1, "the place where float64 is believed has moved: update this test"
text = text.replace(sure, "if (value == 0.0) return 0; if (permanent >= 0.0)")
native.read = lambda which: replace(plain(which), text=text) if which == name else plain(which)
import geometry
from shadow_tracer import Bounds, PointLight, ShadowTracer
light = np.array({light!r})
vertices, triangles = geometry.icosphere(3, 1.0)
bounds = Bounds(max_triangles=2000, max_rays=4000, queue_capacity=60000)
tracer = ShadowTracer("brute_force", "filtered", {device!r}, bounds)
tracer.scene.put("mesh", vertices, triangles)
targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles)])
samples = light + 3.0 * (targets - light)
print("leaks", int((~tracer.occluded(samples, PointLight("lamp", light))).sum()))
"""


@pytest.mark.slow
def test_without_expansion_arithmetic_vertices_leak(any_device: str, tmp_path: Path) -> None:
    """The package, compiled in a separate process with float64 believed everywhere: rays exactly through vertices get
    lost. The light is off the centre of the sphere: from the centre the determinants are so regular that hardly any
    rounds to the wrong sign, and whether one does would hang on the last bits of the vertices."""
    code = _MUTANT.format(root=str(_ROOT), test=str(_ROOT / "test"), device=any_device, light=_INSIDE.tolist())
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("leaks ")]
    assert int(line.split()[1]) > 0, "the watertight test does not notice a decision in plain float64"
