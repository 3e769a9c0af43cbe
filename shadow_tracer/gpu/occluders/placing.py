# SPDX-License-Identifier: Apache-2.0
"""Vertices of meshes from the meshes' frames into the world: the bits of ``Mesh.world_vertices``.

On the CPU they are read where the mesh has them, and all meshes that have moved are one launch: a launch with new
arguments takes longer than the vertices of most parts of a robot.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.scene.checks import FloatArray

_MOST = 64  # meshes of a launch


@wp.struct
class Move:
    """A mesh whose vertices are to be put into the world."""

    row0: wp.vec4d
    row1: wp.vec4d
    row2: wp.vec4d
    local: wp.uint64  # where they are
    order: wp.uint64  # where the number is of the vertex that each place has; 0: each has its own
    count: int
    first: int  # where in the world they are to be


@native.func_native("occluders/transform.h", calls="Transform::block")
def transform_block(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    begin: int,
    end: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """Vertices ``begin`` to ``end`` of a mesh, whose first is number ``first`` of ``world``."""
    ...


@native.func_native("occluders/transform.h", calls="Transform::ordered")
def transform_ordered(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    end: int,
    local: wp.array(dtype=wp.vec3d),
    order: wp.array(dtype=int),
    world: wp.array(dtype=wp.vec3d),
):
    """As ``transform_block`` for all vertices of a mesh, up to ``end``, in another order."""
    ...


@wp.kernel(enable_backward=False)
def transform_vertices(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """world = pose * local, one vertex per thread; ``local`` is as long as ``world``."""
    i = first + wp.tid()
    transform_block(row0, row1, row2, 0, i, i + 1, local, world)


@wp.kernel(enable_backward=False)
def transform_meshes(count: int, moves: wp.array(dtype=Move), world: wp.array(dtype=wp.vec3d)):
    """``transform_vertices`` for all vertices of the first ``count`` moves. One thread."""
    for k in range(count):
        move = moves[k]
        local = wp.array(ptr=move.local, shape=(move.count,), dtype=wp.vec3d)
        if move.order != wp.uint64(0):
            order = wp.array(ptr=move.order, shape=(move.count,), dtype=int)
            transform_ordered(move.row0, move.row1, move.row2, move.first, move.count, local, order, world)
        else:
            transform_block(move.row0, move.row1, move.row2, move.first, 0, move.count, local, world)


class Placing:
    """Puts vertices into the world; in the wide form when ``end`` is called: until then they have to stay where they
    are.

    Args:
        local: vertices of all meshes in their frames, in the CUDA form.
        world: where they are to be.
    """

    def __init__(self, device: Any, local: wp.array, world: wp.array) -> None:
        self._device, self._local, self._world = device, local, world
        self._launch = Launches(device)
        self._moves = wp.zeros(_MOST if forms.wide(device) else 0, dtype=Move, device=device)
        moves = self._moves.numpy()
        self._rows = [moves[name] for name in ("row0", "row1", "row2")]
        self._where, self._orders, self._counts, self._firsts = (
            moves[name] for name in ("local", "order", "count", "first")
        )
        self._count = 0

    def begin(self) -> None:
        """Forget what an earlier call, which an exception ended, has left to be placed."""
        self._count = 0

    def place(self, pose: FloatArray, first: int, count: int, local: int, order: wp.array | None) -> None:
        """Place the vertices of a mesh, from vertex ``first`` on.

        Args:
            pose: (4, 4), of the mesh.
            local: address of the vertices in the wide form.
            order: of each place which vertex it has, in the wide form; None: each has its own.
        """
        if count == 0:
            return
        if not forms.wide(self._device):
            inputs = [*(wp.vec4d(*row) for row in pose[:3]), first, self._local, self._world]
            wp.launch(transform_vertices, dim=count, inputs=inputs, device=self._device)
            return
        if self._count == _MOST:
            self.end()
        number = self._count
        for rows, row in zip(self._rows, pose, strict=False):
            rows[number] = row
        self._orders[number] = 0 if order is None else order.ptr
        self._where[number], self._counts[number], self._firsts[number] = local, count, first
        self._count += 1

    def end(self) -> None:
        """Launch what has not been."""
        count, self._count = self._count, 0
        if count:
            self._launch(transform_meshes, (count,), lambda: (1, [count, self._moves, self._world]))

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._moves.capacity)
