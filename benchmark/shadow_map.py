# SPDX-License-Identifier: Apache-2.0
"""A shadow map, to see how wrong it is: depth from the light on a grid of texels, and each sample compared with the
texel it falls into.

A point light gets a cube of maps (only sides that samples fall on are drawn), the sun one map around the samples. The
drawing is done by OpenGL (moderngl, EGL, no window) where that works, else by numpy: the same map, in seconds instead
of milliseconds, so that of the stand-in only the error means anything.

What a texel holds is ``q``, larger where nearer: the inverse of the depth along the axis of a point light's side, minus
the depth for the sun. Both are linear on the map, so a triangle is a plane there and its three edges are lines.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from procedural import Light

from shadow_tracer import DirectionalLight

BIASES = (1.0, 4.0, 16.0)  # of the scene's bias: a map may need more, to hide the size of its texels
# What a texel holds is moved back by half of what q changes from texel to texel: then no plane shades itself. (OpenGL's
# polygon offset does this. With a whole texel all errors are larger, without any the bias must be metres.)
_SLOPE = 0.5
_CHUNK = 2_000_000  # texels at a time


@dataclass(frozen=True)
class Side:
    """A map's plane: ``matrix`` (3, 4) takes world points to (x, y, w), the map being -1..1 in x/w and y/w; ``near``
    (4,) takes them to what ``q`` is divided by w of: q = near . p / w."""

    matrix: np.ndarray
    near: np.ndarray
    perspective: bool


def sides(light: Light, points: np.ndarray) -> Iterator[tuple[Side, np.ndarray]]:
    """The maps of a light, and which of the (N, 3) points fall on each: (N,) bool."""
    if isinstance(light, DirectionalLight):
        yield _sun(light, points), np.ones(len(points), bool)
        return
    way = points - light.position
    largest = np.abs(way).argmax(axis=1)
    value = np.take_along_axis(way, largest[:, None], axis=1)[:, 0]
    for axis in range(3):
        for sign in (1.0, -1.0):
            mine = (largest == axis) & (sign * value > 0.0)
            if mine.any():
                yield _cube_side(np.asarray(light.position), axis, sign), mine


def _cube_side(position: np.ndarray, axis: int, sign: float) -> Side:
    matrix = np.zeros((3, 4))
    matrix[0, (axis + 1) % 3] = matrix[1, (axis + 2) % 3] = 1.0
    matrix[2, axis] = sign
    matrix[:, 3] = -matrix[:, :3] @ position
    return Side(matrix, np.array([0.0, 0.0, 0.0, 1.0]), True)


def _sun(light: DirectionalLight, points: np.ndarray) -> Side:
    way = np.asarray(light.direction) / np.linalg.norm(light.direction)
    right = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(way, right)])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = 0.5 * (high - low) * (1.0 + 1e-6) + 1e-9
    matrix = np.zeros((3, 4))
    matrix[:2, :3] = axes / half[:, None]
    matrix[:2, 3] = -0.5 * (low + high) / half
    matrix[2, 3] = 1.0
    near = np.append(-way, way @ points.mean(axis=0))
    return Side(matrix, near, False)


class Rasteriser(Protocol):
    """Draws maps of one mesh; ``real`` is a rasteriser whose time means something."""

    name: str
    real: bool

    def draw(self, side: Side, size: int) -> np.ndarray:
        """(size, size) ``q`` of what is nearest to the light at each texel's centre; 0 (sun: -inf) where nothing is."""

    def seconds(self, maps: list[Side], size: int) -> float:
        """How long uploading the mesh and drawing these maps takes."""


class NumpyRasteriser:
    """Rows of each triangle, then the texels of each row between its two edges."""

    name = "numpy"
    real = False

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._corners = np.append(vertices, np.ones((len(vertices), 1)), axis=1)[triangles]  # (T, 3, 4)

    def draw(self, side: Side, size: int) -> np.ndarray:
        seen = self._corners @ side.matrix.T
        x, y, w = (seen[..., k] for k in range(3))
        beyond = [(edge > w).all(axis=1) for edge in (x, -x, y, -y)]
        corners = self._corners[~np.any([*beyond, (w <= 0.0).all(axis=1)], axis=0)]
        edges, q = _planes(side, corners, size)
        rows = _rows(side, corners, size)
        texels = np.full(size * size, 0.0 if side.perspective else -np.inf)
        keep = np.isfinite(edges).all(axis=(1, 2)) & (rows[:, 1] >= rows[:, 0])
        edges, q, rows = edges[keep], q[keep], rows[keep]
        for part in _pieces(rows[:, 1] - rows[:, 0] + 1):
            self._fill(texels, size, edges[part], q[part], rows[part])
        return texels.reshape(size, size)

    @staticmethod
    def _fill(texels: np.ndarray, size: int, edges: np.ndarray, q: np.ndarray, rows: np.ndarray) -> None:
        number, step = _expanded(rows[:, 1] - rows[:, 0] + 1)
        v = rows[number, 0] + step
        left, right = np.zeros(len(v)), np.full(len(v), size - 1.0)
        for k in range(3):
            slope = edges[number, k, 0]
            rest = edges[number, k, 1] * v + edges[number, k, 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                at = -rest / slope
            left = np.where(slope > 0.0, np.maximum(left, at), left)
            right = np.where(slope < 0.0, np.minimum(right, at), right)
            right = np.where((slope == 0.0) & (rest < 0.0), -1.0, right)
        left = np.ceil(np.minimum(left, size)).astype(np.int64)
        right = np.floor(np.maximum(right, -1.0)).astype(np.int64)
        some = right >= left
        number, v, left, right = number[some], v[some], left[some], right[some]
        for part in _pieces(right - left + 1):
            row, step = _expanded(right[part] - left[part] + 1)
            owner, u, line = number[part][row], left[part][row] + step, v[part][row]
            steep = np.abs(q[owner, 0]) + np.abs(q[owner, 1])
            value = q[owner, 0] * u + q[owner, 1] * line + q[owner, 2] - _SLOPE * steep
            np.maximum.at(texels, line * size + u, value)

    def seconds(self, maps: list[Side], size: int) -> float:
        raise NotImplementedError("the stand-in has no time worth telling")


def _planes(side: Side, corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) edge forms and (T, 3) forms of q in texel coordinates (u, v, 1). A texel's centre is inside where all
    three edge forms are not negative; NaN for triangles seen edge-on."""
    matrices = np.swapaxes(corners @ side.matrix.T, 1, 2)  # columns are corners (x, y, w)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        a, b, c = (matrices[:, :, k] for k in range(3))
        volume = np.einsum("ti,ti->t", np.cross(b, c), a)
        inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1) / volume[:, None, None]
    scale = 2.0 / size
    to_map = np.array([[scale, 0.0, 0.5 * scale - 1.0], [0.0, scale, 0.5 * scale - 1.0], [0.0, 0.0, 1.0]])
    with np.errstate(invalid="ignore", over="ignore"):
        edges = inverse @ to_map
        return edges, np.einsum("tk,tkj->tj", corners @ side.near, edges)


def _rows(side: Side, corners: np.ndarray, size: int) -> np.ndarray:
    """(T, 2) first and last row of texels whose centres a triangle may cover; last before first: none."""
    seen = corners @ side.matrix.T
    front = seen[..., 2] > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        v = (seen[..., 1] / seen[..., 2] + 1.0) * 0.5 * size - 0.5
    all_front = front.all(axis=1)
    # A triangle that reaches behind the light may be anywhere; float64 rounding of the others is kept clear of.
    low = np.where(all_front, v.min(axis=1, initial=np.inf, where=front), 0.0)
    high = np.where(all_front, v.max(axis=1, initial=-np.inf, where=front), size - 1.0)
    low, high = np.clip(low, -1.0, size + 1.0), np.clip(high, -2.0, size)
    rows = np.stack([np.maximum(np.ceil(low - 1e-6), 0.0), np.minimum(np.floor(high + 1e-6), size - 1.0)], axis=1)
    rows[~front.any(axis=1)] = [1.0, 0.0]
    return rows.astype(np.int64)


def _pieces(counts: np.ndarray) -> Iterator[slice]:
    """Slices of ``counts`` whose sums are about _CHUNK."""
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        base = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, base + _CHUNK, side="right")), begin + 1)
        yield slice(begin, end)
        begin = end


def _expanded(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index i counts[i] times, and 0 .. counts[i] - 1 beside it."""
    number = np.repeat(np.arange(len(counts)), counts)
    return number, np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)


class GlRasteriser:
    """OpenGL through moderngl and EGL.

    Raises:
        Exception: whatever moderngl raises where there is no OpenGL; see ``rasteriser``.
    """

    real = True

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        gl = importlib.import_module("moderngl")
        self._gl = gl
        self._context = gl.create_context(standalone=True, backend="egl", require=330)
        self.name = f"OpenGL, {self._context.info['GL_RENDERER']}"
        self._middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self._vertices = (vertices - self._middle).astype("f4")
        self._program = self._context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._buffer = self._context.buffer(self._vertices.tobytes())
        indices = self._context.buffer(np.ascontiguousarray(triangles, "i4").tobytes())
        self._array = self._context.vertex_array(self._program, [(self._buffer, "3f", "corner")], indices)
        self._targets: dict[int, Any] = {}

    def _target(self, size: int) -> Any:
        if size not in self._targets:
            # Blending with the maximum instead of a depth buffer of 24 bits: the map at its best.
            texture = self._context.texture((size, size), 1, dtype="f4")
            self._targets[size] = self._context.framebuffer([texture])
        return self._targets[size]

    def _draw(self, side: Side, size: int) -> Any:
        target = self._target(size)
        target.use()
        target.clear(0.0 if side.perspective else -3e38)
        self._context.enable_only(self._gl.BLEND)
        self._context.blend_equation = self._gl.MAX
        self._context.blend_func = self._gl.ONE, self._gl.ONE
        matrix, near = side.matrix.copy(), side.near.copy()
        matrix[:, 3] += matrix[:, :3] @ self._middle
        near[3] += near[:3] @ self._middle
        self._program["matrix"].write(np.ascontiguousarray(np.vstack([matrix, near]).T, "f4").tobytes())
        self._array.render(self._gl.TRIANGLES)
        return target

    def draw(self, side: Side, size: int) -> np.ndarray:
        data = self._draw(side, size).read(components=1, dtype="f4")
        texels = np.frombuffer(data, "f4").reshape(size, size).astype(np.float64)
        return texels if side.perspective else np.where(texels < -1e38, -np.inf, texels)

    def seconds(self, maps: list[Side], size: int) -> float:
        self._context.finish()
        begin = time.perf_counter()
        self._buffer.write(self._vertices.tobytes())
        for side in maps:
            self._draw(side, size)
            self._context.finish()
        return time.perf_counter() - begin


# The fourth row of the matrix is what q is of; depth is clipped at w > 0 only.
_VERTEX = """#version 330
in vec3 corner; uniform mat4 matrix; out float nearness;
void main() {
    vec4 seen = matrix * vec4(corner, 1.0);
    nearness = seen.w;
    gl_Position = vec4(seen.x, seen.y, 0.0, seen.z);
}"""
_FRAGMENT = f"""#version 330
in float nearness; out float q;
void main() {{ float exact = nearness * gl_FragCoord.w; q = exact - {_SLOPE} * fwidth(exact); }}"""


def rasteriser(vertices: np.ndarray, triangles: np.ndarray) -> tuple[Rasteriser, str]:
    """OpenGL where it works, else the stand-in; and why, in words ("" for OpenGL)."""
    try:
        return GlRasteriser(vertices, triangles), ""
    except Exception as error:  # moderngl and EGL raise whatever they like where there is no display or driver
        return NumpyRasteriser(vertices, triangles), str(error).splitlines()[0]


def masks(drawer: Rasteriser, light: Light, points: np.ndarray, bias: float, size: int) -> dict[float, np.ndarray]:
    """(N,) bool, which samples the map says are in shadow, for each of ``BIASES``."""
    found = {factor: np.zeros(len(points), bool) for factor in BIASES}
    for side, mine in sides(light, points):
        texels = drawer.draw(side, size)
        seen = np.append(points[mine], np.ones((mine.sum(), 1)), axis=1) @ side.matrix.T
        texel = np.floor((seen[:, :2] / seen[:, 2:] + 1.0) * 0.5 * size).astype(int).clip(0, size - 1)
        there = texels[texel[:, 1], texel[:, 0]]
        for factor in BIASES:
            start = np.append(_moved(light, points[mine], factor * bias), np.ones((mine.sum(), 1)), axis=1)
            w = start @ side.matrix[2]
            found[factor][mine] = there > (start @ side.near) / w
    return found


def _moved(light: Light, points: np.ndarray, bias: float) -> np.ndarray:
    if isinstance(light, DirectionalLight):
        return points - bias * light.direction / np.linalg.norm(light.direction)
    way = light.position - points
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return points + np.minimum(bias, 0.5 * length) * way / length
