# SPDX-License-Identifier: Apache-2.0
"""The programs of the package as separate processes, with buffers as the tests want them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shadow_tracer import testing

# Small buffers: a node of a test is made in milliseconds.
SMALL = {
    "device": "cpu",
    "bounds.max_triangles": 4096,
    "bounds.max_rays": 128 * 96,
    "bounds.queue_capacity": 16384,
    "diagnostics_period": 0.02,
}


class NodeProcess(testing.NodeProcess):
    """As the package's, on top of :data:`SMALL`."""

    def __init__(self, parameters: Mapping[str, Any] | None = None, **keywords: Any) -> None:
        super().__init__({**SMALL, **(parameters or {})}, **keywords)
