# SPDX-License-Identifier: Apache-2.0
"""What tests ask about the inside of one accelerator, and do to it, by name. Where a ``grid`` is asked for it is what
``probe.pipeline`` returns, or the pipeline of one of ``probe.bands``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import probe

from shadow_tracer import ShadowTracer

if TYPE_CHECKING:  # what lies in gpu is imported when conftest.py has chosen the form
    from shadow_tracer.gpu.accelerators.interface import Rays
    from shadow_tracer.gpu.accelerators.light_grid.binning import Bins
    from shadow_tracer.gpu.accelerators.light_grid.pieces import Pieces
    from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles

# --- cone_hierarchy/linear ---


@dataclass(frozen=True)
class RayTree:
    """The ray tree of ``cone_hierarchy/linear``, what it was made of, and what a descent takes beside it."""

    tree: Any
    order: Any
    frame: Any
    scene: Any
    group: Any
    count: int
    space: Any
    occluders: Any
    answers: Any


def ray_tree(tracer: ShadowTracer, points: Any, light: Any, bias: float) -> RayTree:
    """The tree as it is before any triangle has gone through it: descents close nodes that are done."""
    from shadow_tracer.gpu.exact.faces import Occluders
    from shadow_tracer.gpu.exact.light_frame import make_light_frame
    from shadow_tracer.gpu.exact.light_space import make_light_space

    band, taken = probe.bands(tracer)[0], list[Any]()
    pipeline: Any = band.pipeline
    pipeline._descend = taken.append
    tracer.occluded(points, light, bias)
    del pipeline._descend
    context, who = probe.context(tracer), pipeline._admission
    frame, scene = context.samples, context.scene
    occluders = Occluders()
    occluders.count, occluders.triangles = scene.triangle_count, scene.triangles
    occluders.records, occluders.corners = context.records.memory, pipeline._corners.of(0)
    space = make_light_space(make_light_frame(light, probe.anchor(tracer)))
    tree, answers = pipeline._buffers.tree, band.context.answers(taken[0])
    found = int(who.counts.numpy()[0])
    return RayTree(tree, pipeline._order, frame, scene, who.groups, found, space, occluders, answers)


def build_again(tracer: ShadowTracer, count: int) -> None:
    """Build the ray tree of the first band again, of so many rays that are in order."""
    probe.pipeline(tracer)._buffers.build(count)


def levels(tracer: ShadowTracer) -> int:
    """Of the ray tree of the first band."""
    found: int = probe.pipeline(tracer)._buffers.tree.levels
    return found


# --- both light grids ---


def admission_groups(grid: Any) -> Any:
    """(lights * samples,) array on the device: what has been said of each ray of the pass, see ``admission.py``."""
    return grid._admission.groups


# --- light_grid/packed ---


def tiles(grid: Any) -> Tiles:
    """Of the last pass."""
    found: Tiles = grid._buffers.tiles
    return found


def pack(grid: Any, rays: Rays) -> Tiles:
    """Put the rays of a pass that have been admitted, or are in pieces, into tiles, which are returned."""
    grid._way.pack(rays)
    return tiles(grid)


def limit_rays_at_once(grid: Any, count: int) -> None:
    """Of a pass of several lights that do not rest."""
    grid.traits = replace(grid.traits, rays_at_once=count)


def begin(grid: Any, rays: Rays) -> Pieces | None:
    """Begin a pass; its pieces, in the form of the CPU."""
    grid._begin(rays)
    return grid._way._pieces.of() if hasattr(grid._way, "_pieces") else None


def pieces(grid: Any) -> Pieces:
    """Of the samples as they are, in the form of the CPU."""
    found: Pieces = grid._way._pieces.of()
    return found


def row_of_points(grid: Any) -> int:
    """How many points a row of those asked about last seems to have; 0: none, below zero: they are in no order."""
    return int(grid._way._pieces._width())


def pieces_made(grid: Any) -> int:
    """How many pieces of the last pass are made of the rays of others."""
    tiles, of_pass = grid._buffers.tiles, pieces(grid)
    return int((tiles.numbers.numpy()[: of_pass.count.numpy()[0], 1] >= of_pass.pool_order).sum())


def kept_live(grid: Any, count: int) -> np.ndarray:
    """(count, 32) bool: the rays of each tile before the last frame was traced."""
    bits = grid._way._kept[0][:count, None].view(np.uint32)
    found: np.ndarray = (bits >> np.arange(32, dtype=np.uint32)) & 1
    return found.astype(bool)


def wild_rays(grid: Any) -> np.ndarray:
    """Numbers of the rays of the last pass that are not in tiles and meet every triangle."""
    wild, counts = grid._admission.listed
    found: np.ndarray = wild.numpy()[: counts.numpy()[1]].copy()
    return found


def bins(grid: Any) -> Bins:
    """Lists of entries, in the form of CUDA."""
    found: Bins = grid._way._bins
    return found


def clusters(grid: Any) -> np.ndarray:
    """(N,) the clusters of triangles that a band has looked at for the first light, in the form of the CPU."""
    way = grid._way
    found: np.ndarray = way._clusters.numpy()[: way._ends.numpy()[0]]
    return found


def blocks_made(grid: Any) -> np.ndarray:
    """(N,) bool: whether there are records of each block of 128 triangles, in the form of the CPU, which makes them for
    rays outside of the tiles alone."""
    found: np.ndarray = grid._way._candidates._made.numpy() == 2
    return found


@dataclass(frozen=True)
class Binning:
    """What triangles are held against the boxes of tiles with, see ``light_grid/binning.h``: what there is in one form
    alone, clusters, where each light's end, and their triangles, or occluders, bins and answers."""

    tiles: Tiles
    alone: tuple[Any, ...]


def binning(tracer: ShadowTracer, points: Any, light: Any, bias: float) -> Binning:
    """As it is before any triangle has gone through the tiles, which close those that are done."""
    band, taken = probe.bands(tracer)[0], list[Any]()
    grid: Any = band.pipeline
    way, context = grid._way, band.context
    way.trace = taken.append
    tracer.occluded(points, light, bias)
    del way.trace
    (rays,) = taken
    if probe.wide(tracer.device):
        return Binning(tiles(grid), (way._clusters, way._ends, way.casters(rays)))
    return Binning(tiles(grid), (way.occluders(rays), way._bins, context.answers(rays)))


# --- geometry_image ---


def images(tracer: ShadowTracer) -> list[str]:
    """Names of the surfaces that are geometry images."""
    accelerator: Any = probe.pipeline(tracer)
    return [placed.mesh.name for placed in accelerator._images.placed]


def mip_map(tracer: ShadowTracer) -> tuple[list[np.ndarray], np.ndarray, float]:
    """Boxes (N, 6) of each level of the first image, quads first, and what they are relative to: a place, and how long
    their unit is."""
    accelerator: Any = probe.pipeline(tracer)
    structure, placed = accelerator._images.structure, accelerator._images.placed[0]
    boxes, first = structure.boxes.numpy().reshape(-1, 6), placed.image.first_node
    ends = np.cumsum([first, *placed.nodes])
    levels = [boxes[begin:end].astype(np.float64) for begin, end in zip(ends[:-1], ends[1:], strict=True)]
    return levels, np.array(structure.box.center), 1.0 / float(structure.box.inverse_extent)


def count_mip_maps(tracer: ShadowTracer) -> list[str]:
    """From now on the name of each surface whose boxes are made."""
    names: list[str] = []
    made: Any = probe.pipeline(tracer)
    make = made._images._make

    def note(placed: Any) -> None:
        names.append(placed.mesh.name)
        make(placed)

    made._images._make = note
    return names


def spoil_mip_maps(tracer: ShadowTracer) -> None:
    """Damage the boxes of all geometry images: none holds anything."""
    accelerator: Any = probe.pipeline(tracer)
    accelerator._images.structure.boxes.fill_(1.02)
