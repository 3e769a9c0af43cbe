# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics says about meshes when time has passed: without ROS, and without waiting for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shadow_tracer.ros.diagnostics import ERROR, OK, WARN
from shadow_tracer.ros.node.health_inputs import judge_mesh
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.world.mesh_sources import MeshSources

SETTINGS: Any = SimpleNamespace(
    mesh_frame="", fixed_frame="map", occluders="mesh", uses_meshes=True, uses_depth=False, mesh_files=()
)
GOOD = encode_mesh(np.eye(3), np.array([(0, 1, 2)]))
BAD = encode_mesh(np.full((3, 3), np.nan), np.array([(0, 1, 2)]))
EMPTY = encode_mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


class Inputs:
    """Meshes that come by topics which nobody has remapped."""

    def __init__(self) -> None:
        self.meshes = MeshSources(100, "elevation")

    def mismatch(self, *_: str) -> str:
        return ""

    def topic(self, name: str) -> str:
        return f"/{name}"

    def verdict(self, now: float) -> tuple[bytes, str]:
        inputs: Any = self
        return judge_mesh(inputs, SETTINGS, now, int(now * 1e9))[:2]


@pytest.fixture
def inputs() -> Inputs:
    return Inputs()


def test_without_any_mesh(inputs: Inputs) -> None:
    level, text = inputs.verdict(0.0)
    assert level == WARN and text.startswith("no mesh: every valid pixel is lit; publish")


def test_when_all_that_came_was_refused(inputs: Inputs) -> None:
    """At first as an error; later the refusal is still the reason why everything is lit."""
    for k in range(2):
        inputs.meshes.receive("mesh", BAD, float(k), k)
    level, text = inputs.verdict(2.0)
    assert level == ERROR and "mesh refused, vertices: " in text
    assert text.endswith("; there is no earlier one and masks are unknown; correct the publisher of /mesh")
    level, text = inputs.verdict(60.0)
    assert level == WARN and text.startswith("no mesh: all 2 that came were refused and masks are unknown, vertic")
    assert text.endswith("correct the publisher of /mesh")


def test_when_one_stays(inputs: Inputs) -> None:
    inputs.meshes.receive("mesh", GOOD, 0.0, 0)
    assert inputs.verdict(1.0) == (OK, "1 triangles")
    inputs.meshes.receive("mesh", BAD, 2.0, 2)
    level, text = inputs.verdict(3.0)
    assert level == ERROR and text.endswith("the last good one stays; correct the publisher of /mesh")
    inputs.meshes.receive("mesh_cloud", b"", 2.0, 2)  # what stays came by another topic
    inputs.meshes.receive("mesh", GOOD, 4.0, 4)
    inputs.meshes.clear(5)
    inputs.meshes.receive("mesh", BAD, 5.0, 5)
    assert "there is no earlier one" in inputs.verdict(6.0)[1]


def test_when_the_last_one_was_empty(inputs: Inputs) -> None:
    inputs.meshes.receive("mesh", EMPTY, 0.0, 0)
    level, text = inputs.verdict(1.0)
    assert level == WARN and text.startswith("the meshes have no triangles: every valid pixel is lit")
