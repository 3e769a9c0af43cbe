# SPDX-License-Identifier: Apache-2.0
"""Surfaces as geometry images (Carr, Hoberock, Crane, Hart 2006: "Fast GPU Ray Tracing of Dynamic Meshes using Geometry
Images"): a tree of boxes that is a MIP map of the positions, made on the device whenever these change; rays go through
it in a fixed order, from a node that is met to its first child, and past all below a node that is not.

Surfaces are images, of any numbers of rows and columns; meshes go through another accelerator (``union.py``). What the
paper stores, links to the next node, follows from a node's number here (``images.py``), boxes are float32 and not half
floats, and a ray looks at both triangles of a quad: the paper takes the one on its side of the diagonal, which of a
folded quad, seen from both sides, is not always the one that is met. Both are decided from their coordinates in the
scene (``quad.h``, ``visibility/in_place.h``), with one plane through the sample and the diagonal for both.

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24: the box of a quad holds the corners of its
triangles, and so the triangles. It is padded by 32 u and rounded outwards, as are boxes of triangles (``segment.py``);
that of a node holds those of all its quads, as least and largest numbers of these are not rounded. A quad with a
position that is not valid has the triangle of the three others or none (``scene/surface.py``), and valid positions are
in its box. A triangle that the exact ray meets is in a quad with a key, in the nodes over that up to the root, and so
the exact ray meets all their boxes without padding. A walk loses 5 u to the ray's start and direction, and 6 u to the
roundings of a slab: a difference of at most 2.0002, its rounding 2 u, the product with a reciprocal 4 u as a
displacement of the box's face. So it finds each of these nodes met, by the time that it comes to it, which it does: it
passes by nothing but what is below nodes that are not met, and goes on to the next key after that (``threaded.h``).
A quad whose triangles are taken out for a light, or that has lost a corner, is looked at triangle by triangle.

Boxes stay while a surface stays where it is, and the scene's box, which they are relative to, does not become twice as
small (``segment.holds``). They are those of whatever E was when they were made, and so is the ray.

Memory: a node is 24 bytes, and there are 4/3 of a node for a quad and up to 2.6 where sides are no powers of two,
beside 24 bytes of coordinates for a position and 12 bytes of numbers for a triangle. No records are made.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from shadow_tracer.gpu.accelerators.geometry_image.images import Images, Structure
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.silent import SilentCounts
from shadow_tracer.gpu.accelerators.surfaces import Surfaces
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.visibility.queries import IN_PLACE
from shadow_tracer.scene.mesh import Mesh


class GeometryImages(Surfaces):
    """The ``geometry_image`` pipeline."""

    walk = Walk("accelerators/geometry_image/threaded.h", Structure, queries=(IN_PLACE,))

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(context)
        self._images: Images = context.scene.made.take(Images, lambda: Images(context.scene))
        self._silent: SilentCounts = context.scene.made.take(SilentCounts, lambda: SilentCounts(context.scene))
        self._counted: dict[int, tuple[Hashable, tuple[int, int]]] = {}  # by the numbers of lights

    def structure(self) -> Structure | None:
        """All images."""
        return self._images.structure if self._images.placed else None

    def make(self) -> Sequence[Mesh]:
        """The boxes of surfaces that have changed."""
        self._images.follow()
        return self._images.others

    def forget(self) -> None:
        """Boxes, and what the meshes go through, are to be made again."""
        self._images.forget()
        self._counted.clear()
        self._rest.forget()

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Of the meshes, as their records say, and of the surfaces; counted once for a light that stays over a scene
        that does."""
        rest, scene = self._rest.silent(light), self._context.scene
        cull = self._context.records.front_face_culling
        key = scene.copied, tuple(scene.names_left_out), tuple(light.light), cull
        counted = self._counted.get(light.number)
        if counted is None or counted[0] != key:
            counted = self._counted[light.number] = key, self._count(light, cull)
        return rest[0] + counted[1][0], rest[1] + counted[1][1]

    def _count(self, light: LightFrame, cull: bool) -> tuple[int, int]:
        sums = self._silent
        sums.begin()
        for placed in self._images.placed:
            sums.add(placed.image.first_triangle, len(placed.mesh.triangles), light, cull)
        return sums.total()
