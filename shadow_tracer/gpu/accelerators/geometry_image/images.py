# SPDX-License-Identifier: Apache-2.0
"""Geometry images on the device: the order of their quads, and the MIP maps over them.

The texels of an image are the positions of a surface, as they stand in the scene's buffers: nothing is copied. Its
quads have keys. Square tiles of 2^m quads a side follow each other, along the shorter side of the image first; within a
tile a key has the bits of row and column in turn (Morton 1966), so four keys that differ in the last two bits are two
by two quads. Tiles may stick out of the image, which makes keys that are of no quad: m is the largest for which there
are at most ``_WASTE`` times as many keys as for any other, down to an eighth of the shorter side. Rows and columns may
be of any number.

Node k of level l holds the quads with keys from ``k 4^l`` on, as far as there are keys: ``ceil(keys / 4^l)`` nodes,
which lie one after the other, level by level, the root last. So the children of node k are the nodes from ``4 k`` on,
one level below, and what comes after it and all below it is node ``k + 1``, or, as long as that is a multiple of four,
its quarter one level above. If that begins behind the last key, there is none.

A node is six float32, a box around the valid texels of its quads that have three or four; quads with fewer have no
triangle. What is not a number is asked for, and is in no box. A node without a quad is a point beyond the reach of all
rays (``segment.py``).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import warp as wp

from shadow_tracer.gpu.accelerators.segment import SceneBox, holds, scene_box
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.transfers import HostValues
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.mesh import Mesh

MOST_IMAGES = 64
"""Surfaces beyond that go with the meshes."""
_WASTE = 1.25
# Nodes for each quad there may be: tiles of an eighth of the shorter side stick out by less than a quarter along either
# side, and there are a third more nodes than keys: 1.25^3 * 4/3 < 2.625. A few more for each image, whose levels are
# rounded up.
_NODES_PER_QUAD = 2.625
_MORE_NODES = 16 * MOST_IMAGES
FLOATS = 6
"""Of a node."""


@wp.struct
class Image:
    """A geometry image."""

    rows: int  # of quads
    columns: int
    tile_bits: int  # m: tiles have 2^m quads a side
    tiles_over: int  # tiles along the shorter side
    upright: int  # whether that is a row
    keys: int
    levels: int
    first_vertex: int
    first_triangle: int
    first_node: int  # of level 0
    root: int


@wp.struct
class Structure:
    """All images."""

    box: SceneBox
    count: int
    images: wp.array(dtype=Image)
    boxes: wp.array(dtype=float)


@native.func_native("accelerators/geometry_image/quad_box.h", calls="QuadBox::make")
def box_of_quad(
    image: Image, box: SceneBox, key: int, vertices: wp.array(dtype=wp.vec3d), boxes: wp.array(dtype=float)
):
    """The box of a node of level 0."""
    ...


@native.func_native("accelerators/geometry_image/node_box.h", calls="NodeBox::make")
def box_of_nodes(image: Image, level: int, key: int, first: int, below: int, boxes: wp.array(dtype=float)):
    """The box of a node of another level."""
    ...


@wp.kernel(enable_backward=False)
def boxes_of_quads(image: Image, box: SceneBox, vertices: wp.array(dtype=wp.vec3d), boxes: wp.array(dtype=float)):
    """Boxes of level 0, one each thread."""
    box_of_quad(image, box, wp.tid(), vertices, boxes)


@wp.kernel(enable_backward=False)
def boxes_of_nodes(image: Image, level: int, first: int, below: int, boxes: wp.array(dtype=float)):
    """Boxes of another level, whose first node is number ``first``, one each thread."""
    box_of_nodes(image, level, wp.tid(), first, below, boxes)


@dataclass(frozen=True)
class Layout:
    """How the quads of an image are ordered; see ``Image``."""

    tile_bits: int
    tiles_over: int
    keys: int

    @property
    def nodes(self) -> tuple[int, ...]:
        """Nodes of each level, the quads first."""
        found = [self.keys]
        while found[-1] > 1:
            found.append(-(-found[-1] // 4))
        return tuple(found)


def layout_of(rows: int, columns: int) -> Layout:
    """That of an image of so many rows and columns of quads, at least one each."""
    short, long = sorted((rows, columns))
    largest = (short - 1).bit_length()
    found = []
    for bits in range(largest, max(largest - 3, 0) - 1, -1):
        over, along = -(-short >> bits), -(-long >> bits)
        found.append(Layout(bits, over, over * along << 2 * bits))
    least = min(each.keys for each in found)
    return next(each for each in found if each.keys <= _WASTE * least)


@dataclass(frozen=True)
class Placed:
    """A surface that is an image.

    Attributes:
        key: all that its boxes depend on beside the scene's box.
    """

    mesh: Mesh
    image: Image
    nodes: tuple[int, ...]
    key: Hashable


class Images:
    """Owns the memory of ``Structure``, and makes of it what has changed."""

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        nodes = int(_NODES_PER_QUAD * (scene.bounds.max_triangles // 2)) + _MORE_NODES
        self._values = HostValues(Image, MOST_IMAGES, scene.device)
        self.structure = Structure()
        self.structure.images = self._values.array
        self.structure.boxes = wp.empty(FLOATS * nodes, dtype=float, device=scene.device)
        self.placed: tuple[Placed, ...] = ()
        self.others: list[Mesh] = []
        self._held: tuple[FloatArray, FloatArray] | None = None
        self._followed = -1

    def follow(self) -> None:
        """Make the boxes of surfaces that have changed; of all if the scene's box does not serve any more."""
        scene = self._scene
        if self._followed == scene.copied:
            return
        self._followed = -1
        before, self.placed = {each.key for each in self.placed}, ()
        placed = self._place()
        low, high = scene.box()
        held, self._held = self._held, None
        if held is None or not holds(held, low, high):
            held, before = (low, high), set()
            self.structure.box = scene_box(low, high)
        self.structure.count = len(placed)
        self._values.write([each.image for each in placed])
        for each in placed:
            if each.key not in before:
                self._make(each)
        self.placed, self._held = tuple(placed), held
        self._followed = scene.copied

    def forget(self) -> None:
        """Everything is to be made again."""
        self._followed, self._held, self.placed = -1, None, ()

    def _place(self) -> list[Placed]:
        """The surfaces that have quads, and where their nodes are; what remains is ``others``."""
        placed: list[Placed] = []
        self.others = []
        node = 0
        for mesh, first_vertex, first_triangle in self._scene.placed():
            if mesh.grid is None or not len(mesh.triangles) or len(placed) == MOST_IMAGES:
                self.others.append(mesh)
                continue
            made, nodes = _image(mesh.grid, first_vertex, first_triangle, node)
            revisions = mesh.topology_revision, mesh.vertices_revision, mesh.pose_revision
            placed.append(Placed(mesh, made, nodes, (mesh.name, *revisions, first_vertex, node)))
            node += sum(nodes)
        return placed

    def _make(self, placed: Placed) -> None:
        """The boxes of an image, level by level."""
        structure, device = self.structure, self._scene.device
        inputs = [placed.image, structure.box, self._scene.vertices, structure.boxes]
        wp.launch(boxes_of_quads, dim=placed.nodes[0], inputs=inputs, device=device)
        below = placed.image.first_node
        for level in range(1, len(placed.nodes)):
            first = below + placed.nodes[level - 1]
            inputs = [placed.image, level, first, below, structure.boxes]
            wp.launch(boxes_of_nodes, dim=placed.nodes[level], inputs=inputs, device=device)
            below = first

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.structure.images.capacity + self.structure.boxes.capacity)


def _image(
    grid: tuple[int, int], first_vertex: int, first_triangle: int, first_node: int
) -> tuple[Image, tuple[int, ...]]:
    """An image on the device, and the nodes of its levels."""
    rows, columns = grid[0] - 1, grid[1] - 1
    layout = layout_of(rows, columns)
    nodes = layout.nodes
    made = Image()
    made.rows, made.columns = rows, columns
    made.tile_bits, made.tiles_over, made.upright = layout.tile_bits, layout.tiles_over, int(rows > columns)
    made.keys, made.levels = layout.keys, len(nodes)
    made.first_vertex, made.first_triangle, made.first_node = first_vertex, first_triangle, first_node
    made.root = first_node + sum(nodes[:-1])
    return made, nodes
