# SPDX-License-Identifier: Apache-2.0
"""Independent answers to "is this sample in shadow?", written from the definition and sharing no code with the package.

Definition: sample p, light l, bias b >= 0. p is in shadow iff some triangle, edges and vertices included, meets the
open segment from p + b (l - p) / |l - p| to l (a ray to infinity for a directional light). Two-sided. Inputs are
exact reals. It follows that a light exactly in a triangle's plane, a sample exactly on it (b = 0) and b >= |l - p|
give no shadow: the meeting point is then an end of the segment or beyond it. Zero-area triangles and triangles with
a non-finite corner cast nothing.

Three forms, each with its own algebra:

* `occluded_exact`: rational numbers, literally the definition: meet the plane, then ask where in the triangle that
  is. Slow.
* `occluded_float64`: numpy, one linear form per edge and plane with a forward error bound: sure yes, sure no, or
  unsure.
* `occluded`: `occluded_float64`, with every unsure (sample, triangle) pair decided by `pair_exact` in integers.
  This is the oracle of the test-suite: each sample has one right answer, and no sample is left out for being
  borderline.

Bias without a square root. Let the light be L/w in homogeneous form (w = 1: point L; w = 0: infinitely far along
L), N a normal of the triangle in corner a, flipped so that D = N.(w a - L) > 0, i.e. N points away from the light,
and A = N.(p - a). The line p + s (L - w p), s > 0, meets the plane where A + s (N.L - w N.p) = 0; N.L - w N.p = -(D
+ w A), so s = A / (D + w A), at distance s |L - w p| from p. Hence "beyond the bias" is A > 0 and A |L - w p| > b
(D + w A): both sides are positive, squares decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from culling import candidate_pairs

UNIT = 2.0**-48  # 32 roundings: three rounded factors, two products and at most six sums make fewer than 16
BIAS_TIE = 1e-12  # relative distance from the bias threshold below which the package's rounded threshold may differ
PAIRS_AT_ONCE = 1_500_000


@dataclass(frozen=True)
class Verdict:
    """`hidden` (N,) bool; `margin` (N,) metres by which the sample had to move to change it (a lower bound, 0 at
    shared edges); `unsure` (K,2) (sample, triangle) pairs within rounding of a boundary, of samples that nothing
    else surely hides."""

    hidden: np.ndarray
    margin: np.ndarray
    unsure: np.ndarray


@dataclass(frozen=True)
class Answer:
    """`hidden` (N,) bool, exact; `tie` (N,) bool: the answer hangs on a bias threshold met within 1e-12 relative."""

    hidden: np.ndarray
    tie: np.ndarray


def homogeneous_light(light: Any) -> tuple[np.ndarray, float]:
    """(L, w) with L (3,) float64: the position and 1, or minus the travel direction and 0."""
    position = getattr(light, "position", None)
    if position is not None:
        return np.asarray(position, np.float64), 1.0
    return -np.asarray(light.direction, np.float64), 0.0


def corners_of(vertices: Any, triangles: Any) -> np.ndarray:
    """(T,3,3) float64 corners of the triangles whose corners are all finite."""
    vertices = np.asarray(vertices, np.float64).reshape(-1, 3)
    corners = vertices[np.asarray(triangles, np.int64).reshape(-1, 3)]
    return corners[np.isfinite(corners).all(axis=(1, 2))]


# --- float64 with an error bound ---


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[:, i - 2] * b[:, i - 1] - a[:, i - 1] * b[:, i - 2] for i in range(3)], axis=1)


def _cross_bound(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = np.abs(a), np.abs(b)
    return np.stack([a[:, i - 2] * b[:, i - 1] + a[:, i - 1] * b[:, i - 2] for i in range(3)], axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


@dataclass(frozen=True)
class _Forms:
    """Per triangle four linear forms of q = p - centre: three edges and the plane, `normal`.q + `constant`, signs
    such that D > 0."""

    centre: np.ndarray
    light: np.ndarray
    w: float
    normal: np.ndarray  # (4,T,3)
    constant: np.ndarray  # (4,T)
    normal_bound: np.ndarray  # (4,T,3): sums of absolute terms, to be scaled by UNIT
    constant_bound: np.ndarray
    depth: np.ndarray  # (T,) D > 0
    depth_bound: np.ndarray
    flat: np.ndarray  # (T,) bool: the sign of D is unsure


def _forms(corners: np.ndarray, light: Any) -> _Forms:
    """Edge a,b: det(a - p, b - p, L - w p), expanded around a centre near the triangles: linear in p, no far light
    lost."""
    position, w = homogeneous_light(light)
    centre = corners.reshape(-1, 3).mean(axis=0) if len(corners) else np.zeros(3)
    lamp = position - w * centre
    around = corners - centre
    normals, constants, normal_bounds, constant_bounds = [], [], [], []
    for k in range(3):
        a, along = around[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        far = np.broadcast_to(lamp, a.shape)
        moment, moment_bound = _cross(a, along), _cross_bound(a, along)
        normals.append(w * moment + _cross(along, far))
        normal_bounds.append(w * moment_bound + _cross_bound(along, far))
        constants.append(-_dot(moment, far))
        constant_bounds.append(_dot(moment_bound, np.abs(far)))
    ab, ac, a = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], around[:, 0]
    plane, plane_bound = _cross(ab, ac), _cross_bound(ab, ac)
    depth = _dot(plane, w * corners[:, 0] - position)
    depth_bound = _dot(plane_bound, np.abs(w * corners[:, 0] - position))
    normals.append(plane)
    normal_bounds.append(plane_bound)
    constants.append(-_dot(plane, a))
    constant_bounds.append(_dot(plane_bound, np.abs(a)))
    sign = np.where(depth < 0, -1.0, 1.0)
    flat = ~(np.abs(depth) > UNIT * depth_bound)
    normal, constant = np.stack(normals) * sign[:, None], np.stack(constants) * sign
    bounds = np.stack(normal_bounds), np.stack(constant_bounds)
    return _Forms(centre, position, w, normal, constant, *bounds, depth * sign, depth_bound, flat)


def _classify(forms: _Forms, points: np.ndarray, bias: np.ndarray, rays: Any, tris: Any) -> tuple[np.ndarray, ...]:
    """(sure, unsure, margin), each (R,T) with rays and tris None, else (K,) for the pairs (rays[k], tris[k])."""
    q = points - forms.centre
    reach = np.sqrt(((forms.light - forms.w * points) ** 2).sum(axis=1))
    depth, depth_bound, flat = forms.depth, forms.depth_bound, forms.flat
    if rays is None:
        values = [q @ n.T + c for n, c in zip(forms.normal, forms.constant, strict=True)]
        bounds = [UNIT * (np.abs(q) @ n.T + c) for n, c in zip(forms.normal_bound, forms.constant_bound, strict=True)]
        steep = np.linalg.norm(forms.normal, axis=2)[:, None, :]
        reach, bias = reach[:, None], bias[:, None]
    else:
        q, reach, bias, depth, depth_bound, flat = (
            q[rays],
            reach[rays],
            bias[rays],
            depth[tris],
            depth_bound[tris],
            flat[tris],
        )
        values = [_dot(q, n[tris]) + c[tris] for n, c in zip(forms.normal, forms.constant, strict=True)]
        bounds = [
            UNIT * (_dot(np.abs(q), n[tris]) + c[tris])
            for n, c in zip(forms.normal_bound, forms.constant_bound, strict=True)
        ]
        steep = np.linalg.norm(forms.normal[:, tris], axis=2)
    # the plane condition with the bias, A |L - w p| - b (D + w A) > 0
    above, above_bound = values[3], bounds[3]
    values[3] = above * reach - bias * (depth + forms.w * above)
    bounds[3] = above_bound * (reach + forms.w * bias) + bias * UNIT * depth_bound
    bounds[3] = bounds[3] + UNIT * (np.abs(above) * (reach + forms.w * bias) + bias * depth)
    sure: Any = ~flat
    possible: Any = True
    margin: Any = np.inf
    for k, (value, bound) in enumerate(zip(values, bounds, strict=True)):
        sure = sure & (value > bound)
        possible = possible & ~(value < -bound)  # a NaN is possible, never sure
        with np.errstate(divide="ignore", invalid="ignore"):
            margin = np.fmin(margin, value / (steep[k] * (reach if k == 3 else 1.0)))
    ahead = ~((values[0] < -bounds[0]) | (values[1] < -bounds[1]) | (values[2] < -bounds[2]))
    turned = ~((values[0] > bounds[0]) | (values[1] > bounds[1]) | (values[2] > bounds[2]))
    unsure = ~sure & np.where(flat, ahead | turned, possible)
    return sure, unsure, margin


def _blocks(rays: int, triangles: int) -> Iterator[slice]:
    step = max(1, PAIRS_AT_ONCE // max(triangles, 1))
    for start in range(0, rays, step):
        yield slice(start, min(rays, start + step))


def occluded_float64(
    points: Any, light: Any, vertices: Any, triangles: Any, bias: Any = 0.0, cull: bool = False
) -> Verdict:
    """Every sample against every triangle in float64 (with `cull`: only against those whose box its segment comes
    near).

    points (N,3), vertices (V,3), triangles (T,3); bias a float or (N,) metres. Unsure samples count as lit here.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    biases = np.broadcast_to(np.asarray(bias, np.float64), (len(points),))
    corners = corners_of(vertices, triangles)
    hidden, margin = np.zeros(len(points), bool), np.full(len(points), -np.inf)
    if not len(corners) or not len(points):
        return Verdict(hidden, margin, np.zeros((0, 2), np.int64))
    forms = _forms(corners, light)
    unsure: list[np.ndarray] = []
    if cull:
        for rays, tris in candidate_pairs(points, *homogeneous_light(light), corners, PAIRS_AT_ONCE):
            sure, maybe, metres = _classify(forms, points, biases, rays, tris)
            hidden[rays[sure]] = True
            np.fmax.at(margin, rays, metres)
            unsure.append(np.stack([rays[maybe], tris[maybe]], axis=1))
    else:
        for block in _blocks(len(points), len(corners)):
            sure, maybe, metres = _classify(forms, points[block], biases[block], None, None)
            hidden[block] = sure.any(axis=1)
            margin[block] = metres.max(axis=1)
            unsure.append(np.argwhere(maybe) + [block.start, 0])
    pairs = np.concatenate(unsure) if unsure else np.zeros((0, 2), np.int64)
    return Verdict(hidden, np.abs(margin), pairs[~hidden[pairs[:, 0]]])


# --- exact, in integers ---


def _to_integers(values: list[float]) -> list[int]:
    """The values times one common power of two."""
    ratios = [value.as_integer_ratio() for value in values]
    common = max(denominator for _, denominator in ratios)
    return [numerator * (common // denominator) for numerator, denominator in ratios]


def _det(a: list[int], b: list[int], c: list[int]) -> int:
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def pair_exact(point: np.ndarray, corners: np.ndarray, light: np.ndarray, w: float, bias: float) -> tuple[bool, bool]:
    """(hidden, tie) of one sample and one triangle (3,3), by signs of integer determinants in coordinates relative
    to the sample."""
    lengths = [*point.tolist(), *corners.reshape(-1).tolist(), float(bias)]
    if w:
        numbers = _to_integers([*lengths, *light.tolist()])
        toward = [numbers[13 + i] - numbers[i] for i in range(3)]
    else:
        numbers, toward = _to_integers(lengths), _to_integers(light.tolist())
    a, b, c = ([numbers[3 + 3 * k + i] - numbers[i] for i in range(3)] for k in range(3))
    ab, ac = [b[i] - a[i] for i in range(3)], [c[i] - a[i] for i in range(3)]
    above = -_det(ab, ac, a)  # N.(p - a)
    if w:
        depth = _det(ab, ac, [a[i] - toward[i] for i in range(3)])
    else:
        depth = -_det(ab, ac, toward)
    if depth == 0:
        return False, False
    sign = 1 if depth > 0 else -1
    above, depth = above * sign, depth * sign
    # with N away from the light, the three volumes (edge, light) are turned the other way round
    if any(sign * _det(u, v, toward) > 0 for u, v in ((a, b), (b, c), (c, a))) or above <= 0:
        return False, False
    beyond = above * above * sum(x * x for x in toward)
    threshold = (numbers[12] * (depth + (above if w else 0))) ** 2
    tie = threshold > 0 and abs(beyond - threshold) * 10**12 < 2 * threshold
    return beyond > threshold, tie


def occluded(points: Any, light: Any, vertices: Any, triangles: Any, bias: Any = 0.0, cull: bool = False) -> Answer:
    """The oracle: float64 where it is sure, integers where it is not. Same arguments as `occluded_float64`."""
    points = np.asarray(points, np.float64).reshape(-1, 3)
    biases = np.broadcast_to(np.asarray(bias, np.float64), (len(points),))
    verdict = occluded_float64(points, light, vertices, triangles, bias, cull)
    corners, (lamp, w) = corners_of(vertices, triangles), homogeneous_light(light)
    certain, close, hidden = verdict.hidden.copy(), np.zeros(len(points), bool), verdict.hidden.copy()
    for ray, triangle in verdict.unsure:
        if not certain[ray]:
            yes, near = pair_exact(points[ray], corners[triangle], lamp, w, biases[ray])
            hidden[ray] |= yes
            certain[ray] |= yes and not near
            close[ray] |= near
    return Answer(hidden, close & ~certain)


# --- exact, literally ---


def _inside(x: list[Fraction], a: list[Fraction], b: list[Fraction], c: list[Fraction]) -> bool:
    """Is x, a point of the plane a,b,c, in the closed triangle? By its barycentric coordinates (Gram matrix)."""
    u, v, r = ([end - start for start, end in zip(a, q, strict=True)] for q in (b, c, x))
    uu, uv, vv = _sum(u, u), _sum(u, v), _sum(v, v)
    ru, rv, area = _sum(r, u), _sum(r, v), uu * vv - uv * uv
    beta, gamma = (ru * vv - rv * uv) / area, (rv * uu - ru * uv) / area
    return beta >= 0 and gamma >= 0 and beta + gamma <= 1


def _sum(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _meets(p: list[Fraction], lamp: list[Fraction], w: float, corners: list[list[Fraction]], bias: Fraction) -> bool:
    a, b, c = corners
    u, v = ([end - start for start, end in zip(a, q, strict=True)] for q in (b, c))
    normal = [u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)]
    toward = [x - y for x, y in zip(lamp, p, strict=True)] if w else lamp
    slope = _sum(normal, toward)
    if slope == 0:  # zero area, or the ray runs along the plane: the light, then, is in the plane too
        return False
    at = _sum(normal, [x - y for x, y in zip(a, p, strict=True)]) / slope
    if at <= 0 or (w and at >= 1) or at * at * _sum(toward, toward) <= bias * bias:
        return False
    return _inside([x + at * y for x, y in zip(p, toward, strict=True)], a, b, c)


def occluded_exact(points: Any, light: Any, vertices: Any, triangles: Any, bias: Any = 0.0) -> np.ndarray:
    """(N,) bool, in rational arithmetic, literally the definition. For small sets: about 30 microseconds a pair and
    more."""
    points = np.asarray(points, np.float64).reshape(-1, 3)
    biases = np.broadcast_to(np.asarray(bias, np.float64), (len(points),)).tolist()
    lamp, w = homogeneous_light(light)
    lamp_exact = [Fraction(x) for x in lamp.tolist()]
    corners = [[[Fraction(x) for x in q] for q in three] for three in corners_of(vertices, triangles).tolist()]
    hidden = np.zeros(len(points), bool)
    for i, (point, metres) in enumerate(zip(points.tolist(), biases, strict=True)):
        p = [Fraction(x) for x in point]
        hidden[i] = any(_meets(p, lamp_exact, w, three, Fraction(metres)) for three in corners)
    return hidden
