# SPDX-License-Identifier: Apache-2.0
"""Run outside the source tree by the Python of an environment that holds the library alone.

It imports without ROS and without loading Warp, and it traces.
"""

import importlib.util
import sys

import numpy as np

import shadow_tracer

assert shadow_tracer.__file__.startswith(sys.prefix), f"not the installed package: {shadow_tracer.__file__}"
assert importlib.util.find_spec("rclpy") is None, "this environment holds ROS, so it proves nothing"
assert "warp" not in sys.modules, "import shadow_tracer loads Warp"

tracer = shadow_tracer.ShadowTracer(device="cpu")
tracer.scene.put("roof", np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], dtype=np.float64), np.array([[0, 1, 2]]))
hidden = tracer.occluded(
    np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), shadow_tracer.PointLight("lamp", (0.0, 0.0, 2.0))
)
assert hidden.tolist() == [True, False], hidden
print(f"shadow_tracer imported from {shadow_tracer.__file__}, without ROS, and traced on {tracer.device}")
