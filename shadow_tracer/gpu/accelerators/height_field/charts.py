# SPDX-License-Identifier: Apache-2.0
"""Charts on the device: heights of all positions, and nodes of four by four boxes over them.

A chart takes the world to (column s, row t, height h), h from 0 to 65535 (``scene/chart.py``). On the device its rows
S, T, H, D are made once more for the pose of the surface, and whatever numbers these are define the chart: nothing has
to be exact about them. What a position has in them is computed in float64 from its coordinates in the world,
as they stand in the buffers; the largest distance of a position from its place (column, row) is kept in ``beside``
(one number for each chart), so that whatever the fit or a pose has done to a surface is known. A position with a height
outside 0 to 65535, or with D less than ``nearest``, makes it infinite: then all rays are shown all quads.

Nodes. Level 0 has a node for each four by four quads, level l for each four by four nodes of level l - 1, up to one
node. A node is sixteen pairs of 16 bits: the least and the largest height of the valid positions of each child, rounded
outwards, by more than what heights are off (``ROUNDED``); (65535, 0) where there is none. The children of a node lie
in one line of the cache.

Of the surface of a depth image, which is made on the device, only what its triangles have counts: a quad over a step in
depth has none. Its corners without depth are where the camera is, and have no height; should a triangle have a corner
there, of a depth that is nothing beside the camera's distance from the origin, all rays are shown all quads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.transfers import HostValues
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.chart import STEPS, Chart, depth_chart, find_chart
from shadow_tracer.scene.mesh import Mesh
from shadow_tracer.scene.parts import DepthSurface

# Surfaces with a chart; others go with the meshes, as do those of fewer quads, and those of more rows or columns than
# float32 can count in well.
MOST_CHARTS = 64
_FEWEST_QUADS = 64
_LONGEST = 2**16
LEVELS = 9  # of 4^9 quads along an axis
# What boxes are padded with, in units of the largest row or column, and of the span of heights: 2^-19, 32 roundings.
PADDING = 2.0**-19
# How far from their places, in cells, positions may be where heights alone are to decide something.
BESIDE = 2.0**-27
# Outwards, in steps: float32 heights are off by 2^-9 of one, and 2^-14 where they were computed.
ROUNDED = 2.0**-6
native.constants(CHART_PADDING=PADDING, CHART_STEPS=STEPS, CHART_LEVELS=LEVELS, CHART_ROUNDED=ROUNDED)


@wp.struct
class DeviceChart:
    """A chart, its surface, and where its nodes are."""

    center: wp.vec3d
    s: wp.vec4d
    t: wp.vec4d
    h: wp.vec4d
    d: wp.vec4d
    nearest: wp.float64
    weight: wp.float64  # see chart_ray.h
    weight_constant: wp.float64
    rows: int  # of positions
    columns: int
    first_vertex: int
    first_triangle: int
    first_height: int
    parallel: int
    made: int  # whether it is the surface of a depth image
    camera: wp.vec3d  # of which this is the place


@wp.struct
class Level:
    """Nodes of a level of a chart."""

    first: int
    rows: int
    columns: int


@wp.struct
class Sweep:
    """How the sun goes over a chart, see ``sweep.py``."""

    number: int  # of the chart, -1 if none is swept
    lines: int
    across: int  # places on a line
    pitch: int  # of the bounds: from line to line, not a power of two, which caches do not like
    base: int  # of the heights: the first place of the first line
    next_line: int  # from there to the next line
    next: int  # and to the next place
    by_rows: int  # whether lines are rows
    mirrored: int  # whether the first line is the last row or column
    drift: wp.float64  # of the way to the sun from line to line, in places
    rise: wp.float64  # and in steps
    per_metre: wp.float64  # of that way, in lines
    pad: float


@wp.struct
class Structure:
    """All charts: of each ``CHART_LEVELS`` levels, the last of which that has nodes has one."""

    count: int
    charts: wp.array(dtype=DeviceChart)
    levels: wp.array(dtype=Level)
    beside: wp.array(dtype=wp.float64)
    nodes: wp.array(dtype=wp.uint32)
    heights: wp.array(dtype=float)
    sweep: Sweep
    bounds: wp.array(dtype=float)


@native.func_native("accelerators/height_field/place.h", calls="Placed::row")
def place_row(
    chart: DeviceChart, row: int, vertices: wp.array(dtype=wp.vec3d), heights: wp.array(dtype=float)
) -> wp.float64:
    """Store the heights of a row of positions; returns how far valid ones are from their places at most."""
    ...


@wp.kernel(enable_backward=False)
def place_positions(number: int, structure: Structure, vertices: wp.array(dtype=wp.vec3d)):
    """Heights of a chart's positions, a row each thread."""
    off = place_row(structure.charts[number], wp.tid(), vertices, structure.heights)
    wp.atomic_max(structure.beside, number, off)


@native.func_native("accelerators/height_field/nodes.h", calls="Nodes::of_quads")
def node_of_quads(
    first: int,
    rows: int,
    columns: int,
    row: int,
    column: int,
    node: int,
    heights: wp.array(dtype=float),
    nodes: wp.array(dtype=wp.uint32),
):
    """The node over the quads from four times ``row`` and ``column`` on."""
    ...


@native.func_native("accelerators/height_field/nodes.h", calls="Nodes::of_triangles")
def node_of_triangles(
    first: int,
    vertex: int,
    triangle: int,
    rows: int,
    columns: int,
    row: int,
    column: int,
    node: int,
    heights: wp.array(dtype=float),
    triangles: wp.array(dtype=wp.vec3i),
    nodes: wp.array(dtype=wp.uint32),
) -> int:
    """As ``node_of_quads``, over the triangles of these quads; returns whether one has a corner without a height."""
    ...


@native.func_native("accelerators/height_field/nodes.h", calls="Nodes::of_nodes")
def node_of_nodes(
    first: int, rows: int, columns: int, row: int, column: int, node: int, nodes: wp.array(dtype=wp.uint32)
):
    """The node over the nodes of a level from four times ``row`` and ``column`` on."""
    ...


@wp.kernel(enable_backward=False)
def make_nodes(number: int, level: int, structure: Structure, triangles: wp.array(dtype=wp.vec3i)):
    """The nodes of a level, one each thread."""
    i = wp.tid()
    here = structure.levels[number * LEVELS + level]
    row = i // here.columns
    column = i - row * here.columns
    node = here.first + i
    if level == 0:
        chart = structure.charts[number]
        if chart.made != 0:
            lost = node_of_triangles(
                chart.first_height, chart.first_vertex, chart.first_triangle, chart.rows, chart.columns, row, column,
                node, structure.heights, triangles, structure.nodes,
            )  # fmt: skip
            if lost != 0:
                wp.atomic_max(structure.beside, number, wp.float64(1.0e30))
        else:
            node_of_quads(
                chart.first_height, chart.rows, chart.columns, row, column, node, structure.heights, structure.nodes
            )
    else:
        below = structure.levels[number * LEVELS + level - 1]
        node_of_nodes(below.first, below.rows, below.columns, row, column, node, structure.nodes)


@dataclass(frozen=True)
class Placed:
    """A surface with a chart, and where it lies.

    Attributes:
        key: all that what is made of it depends on.
        shapes: rows and columns of nodes of each level.
    """

    mesh: Mesh
    chart: Chart
    first_vertex: int
    first_triangle: int
    first_height: int
    first_node: int
    key: tuple[object, ...]
    shapes: tuple[tuple[int, int], ...]

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of positions."""
        grid = _grid_of(self.mesh)
        assert grid is not None
        return grid


def _grid_of(mesh: Mesh) -> tuple[int, int] | None:
    """Rows and columns of positions; None of meshes."""
    return mesh.corners if isinstance(mesh, DepthSurface) else mesh.grid


def _shapes(grid: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    rows, columns = grid[0] - 1, grid[1] - 1
    found: list[tuple[int, int]] = []
    while not found or rows * columns > 1:
        rows, columns = -(-rows // 4), -(-columns // 4)
        found.append((rows, columns))
    return tuple(found)


class Charts:
    """Owns the memory of ``Structure``, and makes of it what has changed."""

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        bounds, device, quads = scene.bounds, scene.device, scene.bounds.max_triangles // 2
        self._most_nodes = quads // 8 + 64
        self._values = HostValues(DeviceChart, MOST_CHARTS, device)
        self._levels = HostValues(Level, MOST_CHARTS * LEVELS, device)
        self.structure = structure = Structure()
        structure.charts, structure.levels = self._values.array, self._levels.array
        structure.beside = wp.zeros(MOST_CHARTS, dtype=wp.float64, device=device)
        structure.nodes = wp.empty(16 * self._most_nodes, dtype=wp.uint32, device=device)
        structure.heights = wp.empty(bounds.max_triangles, dtype=float, device=device)
        self.placed: tuple[Placed, ...] = ()
        self.on_device: list[DeviceChart] = []
        self.others: list[Mesh] = []
        self._found: dict[str, tuple[int, int, Chart | None]] = {}
        self._followed = -1

    def follow(self) -> None:
        """Make what depends on surfaces that have changed."""
        scene = self._scene
        if self._followed == scene.copied:
            return
        self._followed = -1
        before, self.placed = {each.key for each in self.placed}, ()
        placed = self._place()
        structure = self.structure
        structure.count = len(placed)
        self.on_device = [_on_device(each) for each in placed]
        self._values.write(self.on_device)
        self._levels.write([level for each in placed for level in _levels(each)])
        for number, each in enumerate(placed):
            if each.key not in before:
                self._make(number, each)
        self.placed = tuple(placed)
        self._followed = scene.copied

    def forget(self) -> None:
        """Everything is to be made again."""
        self._followed, self.placed = -1, ()

    def _chart_of(self, mesh: Mesh) -> Chart | None:
        grid = _grid_of(mesh)
        if grid is None or mesh.triangle_count < 2 * _FEWEST_QUADS or max(grid) > _LONGEST:
            return None
        known = self._found.get(mesh.name)
        if known is None or known[:2] != (mesh.topology_revision, mesh.vertices_revision):
            chart = depth_chart(mesh) if isinstance(mesh, DepthSurface) else find_chart(mesh.vertices, grid)
            known = self._found[mesh.name] = mesh.topology_revision, mesh.vertices_revision, chart
        return known[2]

    def _place(self) -> list[Placed]:
        """The surfaces that there is room for, and where; the others are ``others``."""
        placed: list[Placed] = []
        self.others = []
        height = node = 0
        for mesh, first_vertex, first_triangle in self._scene.placed():
            chart = self._chart_of(mesh) if len(placed) < MOST_CHARTS else None
            grid = _grid_of(mesh)
            shapes = _shapes(grid) if chart is not None and grid is not None else ()
            nodes = sum(rows * columns for rows, columns in shapes)
            full = node + nodes > self._most_nodes or height + mesh.vertex_count > len(self.structure.heights)
            if chart is None or full:
                self.others.append(mesh)
                continue
            key = mesh.name, mesh.topology_revision, mesh.vertices_revision, mesh.pose_revision
            where = first_vertex, first_triangle, height, node
            placed.append(Placed(mesh, chart, *where, (len(placed), *key, *where), shapes))
            height += mesh.vertex_count
            node += nodes
        names = {mesh.name for mesh, _, _ in self._scene.placed()}
        self._found = {name: found for name, found in self._found.items() if name in names}
        return placed

    def _make(self, number: int, placed: Placed) -> None:
        """Heights and nodes of a chart."""
        device, structure = self._scene.device, self.structure
        structure.beside[number : number + 1].zero_()
        inputs = [number, structure, self._scene.vertices]
        wp.launch(place_positions, dim=placed.grid[0], inputs=inputs, device=device)
        for level, (rows, columns) in enumerate(placed.shapes):
            inputs = [number, level, structure, self._scene.triangles]
            wp.launch(make_nodes, dim=rows * columns, inputs=inputs, device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        structure = self.structure
        arrays = structure.charts, structure.levels, structure.beside, structure.nodes, structure.heights
        return sum(int(array.capacity) for array in arrays)


def _levels(placed: Placed) -> list[Level]:
    found: list[Level] = []
    first = placed.first_node
    for rows, columns in (*placed.shapes, *((0, 0),) * (LEVELS - len(placed.shapes))):
        level = Level()
        level.first, level.rows, level.columns = first, rows, columns
        found.append(level)
        first += rows * columns
    return found


def _on_device(placed: Placed) -> DeviceChart:
    """The chart for the pose of its surface, and the weights of its rows: each row is at most ``weight`` times the sum
    of the magnitudes of a point's coordinates, plus ``weight_constant`` for what lies among the positions, in units of
    what its padding is relative to."""
    chart, pose = placed.chart, placed.mesh.pose
    rotation, position = pose[:3, :3], pose[:3, 3]
    center = rotation @ chart.center + position
    lines = np.empty((4, 4))
    lines[:, :3] = chart.rows[:, :3] @ rotation.T
    lines[:, 3] = chart.rows[:, 3] + chart.rows[:, :3] @ (rotation.T @ (center - position) - chart.center)
    rows, columns = placed.grid
    along = float(max(rows, columns) - 1)
    units = np.array([along, along, STEPS, 1.0]) * chart.nearest
    made = DeviceChart()
    made.center = wp.vec3d(*center)
    made.s, made.t, made.h, made.d = (wp.vec4d(*line) for line in lines)
    made.nearest = chart.nearest
    weight = float((np.abs(lines[:, :3]).max(axis=1) / units).max())
    made.weight = weight
    made.weight_constant = float((np.abs(lines[:, 3]) / units).max()) + 3.01 * weight * chart.extent
    made.rows, made.columns = rows, columns
    made.first_vertex, made.first_triangle = placed.first_vertex, placed.first_triangle
    made.first_height, made.parallel = placed.first_height, int(chart.parallel)
    made.made, made.camera = int(isinstance(placed.mesh, DepthSurface)), wp.vec3d(*position)
    return made
