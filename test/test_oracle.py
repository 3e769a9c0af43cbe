# SPDX-License-Identifier: Apache-2.0
"""The oracles against each other: the fast one must equal the literal one everywhere, ties included, or no other
test means anything."""

from __future__ import annotations

from collections.abc import Callable

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import DirectionalLight, PointLight

_MESHES: dict[str, Callable[[np.random.Generator], geometry.Geometry]] = {
    "soup": lambda rng: geometry.soup(rng, 14, 0.8, 2.0),
    "integers": lambda rng: geometry.integer_soup(rng, 16),
    "slivers": lambda rng: geometry.slivers(rng, 14),
    "boxes": lambda rng: geometry.join(
        [geometry.box((-1, -1, -1), (1, 1, 1)), geometry.box((-3, -3, -2), (3, 3, -1.5))]
    ),
}


def _lights(vertices: np.ndarray) -> list[PointLight | DirectionalLight]:
    positions = [(0.1, 0.2, 0.3), (0, 0, 0), (1, 1, 1), (1e6, 2e5, 3e4), vertices[0], vertices[:2].mean(axis=0)]
    return [PointLight("lamp", p) for p in positions] + [
        DirectionalLight("sun", d) for d in [(0, 0, -1), (1, 2, -4), (0.3, 0.2, -1)]
    ]


@pytest.mark.slow
@pytest.mark.parametrize("kind", _MESHES)
def test_fast_oracle_equals_the_literal_definition(kind: str) -> None:
    rng = np.random.default_rng(20)
    vertices, triangles = _MESHES[kind](rng)
    points = np.concatenate(
        [
            rng.integers(-4, 5, (10, 3)).astype(float),
            rng.normal(size=(6, 3)) * 4,
            vertices[:4],
            1.5 * vertices[triangles[:6]].mean(axis=1),
            geometry.edge_points(vertices, triangles[:2]),
        ]
    )
    hidden = unsure = 0
    for light in _lights(vertices):
        for bias in (0.0, 0.01, 2.0):
            literal = oracle.occluded_exact(points, light, vertices, triangles, bias)
            for cull in (False, True):
                answer = oracle.occluded(points, light, vertices, triangles, bias, cull)
                np.testing.assert_array_equal(answer.hidden, literal, err_msg=f"{light} bias {bias} cull {cull}")
            verdict = oracle.occluded_float64(points, light, vertices, triangles, bias)
            sure = np.setdiff1d(np.arange(len(points)), verdict.unsure[:, 0])
            np.testing.assert_array_equal(verdict.hidden[sure], literal[sure])
            hidden, unsure = hidden + int(literal.sum()), unsure + len(verdict.unsure)
    assert hidden > 20, "the scenes cast next to no shadow: nothing was compared"
    assert unsure > 0, "no borderline sample: the exact form was never needed"


def test_culling_changes_nothing() -> None:
    rng = np.random.default_rng(21)
    vertices, triangles = geometry.street(rng)
    chosen = triangles[rng.integers(0, len(triangles), 400)]
    points = (vertices[chosen] * rng.dirichlet([1, 1, 1], 400)[:, :, None]).sum(axis=1)
    for light in (
        PointLight("lamp", (1, 1, 4)),
        PointLight("star", (1e7, 3e6, 2e7)),
        DirectionalLight("sun", (0.3, 0.4, -1)),
    ):
        answers = [oracle.occluded(points, light, vertices, triangles, 0.01, cull) for cull in (False, True)]
        np.testing.assert_array_equal(answers[0].hidden, answers[1].hidden)
        assert 0.1 < answers[0].hidden.mean() < 0.9


def test_rules_of_the_definition() -> None:
    vertices, triangles = geometry.square(2, 0.0, 1.0)
    lamp = PointLight("lamp", (0, 0, 2))

    def hidden(
        point: tuple[float, float, float], light: PointLight | DirectionalLight = lamp, bias: float = 0.0
    ) -> bool:
        return bool(oracle.occluded_exact([point], light, vertices, triangles, bias)[0])

    assert hidden((0, 0, -1)) and hidden((0.3, 0.2, -1e-9)), "behind the square"
    assert hidden((2, 0, -2)) and hidden((2, 2, -2)) and not hidden((2.0000001, 0, -2)), (
        "edges and corners belong to it"
    )
    assert not hidden((0.3, 0.2, 0)), "the plane does not: the segment is open"
    assert not hidden((0, 0, -1), PointLight("lamp", (0.2, 0, 0))), "a light in the plane casts nothing"
    assert not hidden((0, 0, 1)) and not hidden((0, 0, 2)), "beside the light, and at it"
    assert hidden((0, 0, -1), bias=0.99) and not hidden((0, 0, -1), bias=1.0), "the biased start is exclusive too"
    assert not hidden((0, 0, -1), bias=3.0) and not hidden((0, 0, -1), bias=50.0), "nothing is left of the segment"
    assert hidden((0, 0, -1), DirectionalLight("sun", (0, 0, -3)), 0.99) and not hidden(
        (0, 0, -1), DirectionalLight("sun", (0, 0, -3)), 1.0
    )
    assert not hidden((0, 0, -1), DirectionalLight("sun", (1, 0, 0))), "a direction in the plane casts nothing"
    flat = oracle.occluded_exact([(0, 0, -1)], lamp, [[-1, 0, 0], [1, 0, 0], [0, 0, 0]], [[0, 1, 2]])
    assert not flat[0], "zero area casts nothing"
