# SPDX-License-Identifier: Apache-2.0
"""A question with one right answer: samples, a light and a mesh, checked against the oracle on any tracer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import oracle

# Brute force on a CPU must stay in seconds: it gets every k-th sample, so that no more than this many pairs are tested.
_PAIRS = {"filtered": 30_000_000, "float64": 1_500_000}


def stride_for(tracer: Any, samples: int, triangles: int) -> int:
    """Every how manieth sample a tracer is asked for; 1 for everything but brute force."""
    if tracer.pipeline != "brute_force":
        return 1
    return max(1, -(-samples * max(triangles, 1) // _PAIRS.get(tracer.variant, _PAIRS["filtered"])))


@dataclass(frozen=True)
class Scenario:
    """points (N,3), a light of the package, a mesh, and a bias in metres. `answer` is computed once, by the oracle."""

    points: np.ndarray
    light: Any
    vertices: np.ndarray
    triangles: np.ndarray
    bias: float = 0.0
    cull: bool = False

    @cached_property
    def answer(self) -> oracle.Answer:
        return oracle.occluded(self.points, self.light, self.vertices, self.triangles, self.bias, self.cull)

    def check(self, tracer: Any) -> np.ndarray:
        """Put the mesh into the tracer's scene, ask, and compare every sample; returns what the tracer said of the
        samples asked."""
        tracer.scene.put("mesh", self.vertices, self.triangles, nonfinite="skip")
        step = stride_for(tracer, len(self.points), len(self.triangles))
        points = self.points[::step]
        hidden = tracer.occluded(points, self.light, self.bias)
        assert hidden.shape == (len(points),) and hidden.dtype == np.bool_
        compare(hidden, self.answer.hidden[::step], self.answer.tie[::step], points)
        return hidden


def compare(hidden: np.ndarray, expected: np.ndarray, tie: np.ndarray, points: np.ndarray) -> None:
    """Equal bits for all samples but those on a rounded bias threshold, which may be no more than one in a thousand."""
    assert tie.sum() <= max(1, len(tie) // 1000), (
        f"{tie.sum()} of {len(tie)} samples lie on the bias threshold: a bad test scene"
    )
    wrong = np.flatnonzero((hidden != expected) & ~tie)
    if len(wrong):
        first = wrong[0]
        raise AssertionError(
            f"{len(wrong)} of {len(hidden)} samples wrong; sample {first} at {points[first].tolist()}: "
            f"got hidden={bool(hidden[first])}"
        )
