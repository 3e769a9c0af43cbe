# SPDX-License-Identifier: Apache-2.0
"""Bundles of rays and triangles for tests of the nodes of ray hierarchies, and the exact decision for every pair."""

from __future__ import annotations

import geometry
import numpy as np
import warp as wp

from shadow_tracer import DirectionalLight, PointLight
from shadow_tracer.gpu.exact.decision import decide
from shadow_tracer.scene.lights import Light

SPREADS = (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0, 1.4, 1.5697, 1.8, 2.5, np.pi)
RAYS = 64  # per spread: levels 1 to 3 stay within a bundle
TRIANGLES = 36  # per spread
LIGHTS: dict[str, Light] = {
    "inside": PointLight("lamp", (0.13, -0.21, 0.34)),
    "outside": PointLight("lamp", (9.0, 7.0, -8.0)),
    "far": PointLight("lamp", (3e5, -1e5, 5e5)),
    "sun": DirectionalLight("sun", (0.31, -0.42, -0.87)),
}


@wp.kernel(enable_backward=False)
def decide_all(
    light: wp.vec4d,
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    hidden: wp.array2d(dtype=wp.uint8),
):
    i, t = wp.tid()
    corners = triangles[t]
    a = vertices[corners[0]]
    b = vertices[corners[1]]
    c = vertices[corners[2]]
    hidden[i, t] = wp.uint8(decide(samples[i], light, a, b, c) & 1)


def bundles(rng: np.random.Generator, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """(rays, triangles): a bundle of samples for each spread, as angle or (far lights) sideways, and triangles in
    front of, around and behind it. (B, RAYS, 3) and (B, TRIANGLES, 3, 3)."""
    lamp = light.homogeneous
    samples, corners = [], []
    for spread in SPREADS:
        middle = geometry.directions(rng, 1)[0]
        aside = geometry.directions(rng, RAYS) * spread * rng.uniform(0.0, 1.0, (RAYS, 1))
        turned = middle + aside if spread < 1.5 else geometry.directions(rng, RAYS)
        if 1.5 < spread < 3.0:  # every direction within the angle of the middle
            along = np.cos(spread * rng.uniform(0.0, 1.0, (RAYS, 1)))
            across = np.cross(middle, geometry.directions(rng, RAYS))
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            turned = along * middle + np.sqrt(1.0 - along**2) * across
        # Corners around the middle, a few bundle widths wide, at any distance and partly on the light's other side;
        # half of the triangles lie around the middle, so that they may cover the bundle.
        width = rng.choice([0.5, 2.0, 8.0], (TRIANGLES, 1, 1)) * (spread + 1e-7) + rng.choice(
            [0.0, 0.0, 0.0, 0.3, 2.0], (TRIANGLES, 1, 1)
        )
        spin = rng.uniform(0.0, 6.28, (TRIANGLES, 1)) + np.array([0.0, 2.1, 4.2])
        u = np.cross(middle, [0.3, -0.5, 0.8])
        v = np.cross(middle, u / np.linalg.norm(u))
        around = np.cos(spin)[..., None] * np.cross(v, middle) + np.sin(spin)[..., None] * v
        loose = np.arange(TRIANGLES) % 2 == 1
        around[loose] = geometry.directions(rng, 3 * loose.sum()).reshape(-1, 3, 3)
        ways = middle + width * around
        ways[::9, 1] = ways[::9, 0] + 1e-4 * (ways[::9, 1] - ways[::9, 0])  # slivers
        ways[4::9, 0] = turned[rng.integers(0, RAYS, len(ways[4::9]))]  # a corner exactly on a ray
        length = rng.uniform(0.05, 1.6, (TRIANGLES, 1, 1)) * rng.uniform(0.7, 1.3, (TRIANGLES, 3, 1))
        length[::7, 2] *= -1.0
        length[3::11] *= -1.0
        length[5::12] *= 40.0
        away = rng.uniform(0.9, 1.0, (RAYS, 1)) * rng.uniform(1.0, 3.0)
        if np.linalg.norm(lamp[:3]) < 1.0 and lamp[3]:
            samples.append(lamp[:3] + turned * away)
            corners.append(lamp[:3] + ways * length)
        else:
            # The same seen along the light's direction: sideways offsets, and heights over the samples.
            base = rng.uniform(-2.0, 2.0, 3)
            up = lamp[:3] - lamp[3] * base
            up /= np.linalg.norm(up)
            samples.append(base + (turned - middle) - 0.3 * up * (away - 1.0))
            corners.append(base + (ways - middle) + up * (length - 0.2))
    return np.array(samples), np.array(corners)
