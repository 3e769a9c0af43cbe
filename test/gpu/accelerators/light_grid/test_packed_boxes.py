# SPDX-License-Identifier: Apache-2.0
"""Triangles against the boxes of tiles, blocks and columns, alone: nothing that the exact decision calls hidden is
rejected, nothing it calls lit is covered, by either form; and both happen often."""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any

import bundles
import numpy as np
import packed_grid
import probe
import probe_accelerators
import pytest
import warp as wp
from node_fuzz import LIGHTS, SPREADS, TRIANGLES, decide_all
from node_fuzz import bundles as all_bundles
from packed_grid import LEVELS

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.light_grid.binning import Bins, Casters
from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame, make_light_frame
from shadow_tracer.gpu.exact.light_space import LightSpace, make_light_space
from shadow_tracer.gpu.visibility.answers import Answers

# What becomes of a triangle and a box: it casts nothing, cannot touch the face or is not among the candidates; the
# column is not among those looked up; its bounds miss the box; its planes do; it may meet the box; it covers it.
_ABSENT, _BESIDE, _UNTOUCHED, _MISSED, _MET, _COVERED = range(6)

# Expects `box`: (level, number, group, column) as in packed_grid.Boxes.
_SCALAR = """
    Binning it(triangle, box[2] / 6, 0, 0, space, tiles, occluders, bins, answers);
    Front1 front;
    it.open(front);
    if (!it.look(front, box[2] % 6))
        return 0;
    int from, to;
    TileGroup(tiles, box[2]).columns(it.side.low_u, it.side.high_u, from, to);
    if (box[3] < from || box[3] > to)
        return 1;
    const wp::array_t<float>& boxes = box[0] == 0 ? tiles.boxes : box[0] == 1 ? tiles.blocks : tiles.columns;
    if (!it.side.touches(TileBox::at(boxes, box[1])))
        return 2;
    int covered = 0;
    return it.meets(boxes, box[1], covered) ? (covered ? 5 : 4) : 3;
"""
# The visit of binning16.h does not say what it leaves out: how it looks up columns is repeated here.
_WIDE = """
    bool listed = false;
    for (int k = 0; k < ends.data[0]; ++k)
        listed |= clusters.data[k] == triangle / 16;
    if (!listed)
        return 0;
    const int place = box[2] / 6, face = box[2] % 6, lane = triangle % 16;
    Cluster cluster(casters, frame, space);
    cluster.open(triangle / 16, tiles.aligned.data[place] != 0);
    Seen16 seen;
    if (!(cluster.front.bound(face, tiles.fit.data[box[2]], space.inverse != 0, seen) >> lane & 1))
        return 0;
    float records[256];
    cluster.take(place, records);
    if (cluster.planes.silent >> lane & 1)
        return 0;
    Side16 side;
    side.take(cluster.planes, seen, face, lane);
    int from, to;
    TileGroup(tiles, box[2]).columns(side.low_u, side.high_u, from, to);
    const int unit = side.bounded && to - from < 4 ? 1 : 16;
    if (from > to || box[3] / unit < from / unit || box[3] / unit > to / unit)
        return 1;
    const wp::array_t<float>& boxes = box[0] == 0 ? tiles.boxes : box[0] == 1 ? tiles.blocks : tiles.columns;
    const float* sixteen = TileBox::at(boxes, box[1] & ~15);
    if (!(side.touches(sixteen) >> (box[1] & 15) & 1))
        return 2;
    int covered = 0;
    const int met = side.meets(sixteen, covered);
    return met >> (box[1] & 15) & 1 ? (covered >> (box[1] & 15) & 1 ? 5 : 4) : 3;
"""


@wp.func_native(native.snippet("accelerators/light_grid/binning.h", call=_SCALAR))
def judge(
    triangle: int,
    box: wp.vec4i,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
) -> int: ...


@wp.func_native(
    native.snippet(
        "accelerators/light_grid/tiles.h", "accelerators/light_grid/cluster.h", call=_WIDE, otherwise="return 0;"
    )
)
def judge_wide(
    triangle: int,
    box: wp.vec4i,
    clusters: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    casters: Casters,
    frame: LightFrame,
    space: LightSpace,
    tiles: Tiles,
) -> int: ...


@wp.kernel(enable_backward=False)
def judge_all(
    boxes: wp.array(dtype=wp.vec4i),
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
    out: wp.array2d(dtype=int),
):
    number, triangle = wp.tid()
    out[number, triangle] = judge(triangle, boxes[number], space, tiles, occluders, bins, answers)


@wp.kernel(enable_backward=False)
def judge_all_wide(
    boxes: wp.array(dtype=wp.vec4i),
    clusters: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    casters: Casters,
    frame: LightFrame,
    space: LightSpace,
    tiles: Tiles,
    out: wp.array2d(dtype=int),
):
    number, triangle = wp.tid()
    out[number, triangle] = judge_wide(triangle, boxes[number], clusters, ends, casters, frame, space, tiles)


_MOST_RAYS, _MOST_TRIANGLES = 1024, len(SPREADS) * TRIANGLES


def _tracer(device: str) -> ShadowTracer:
    return probe.reset(_shared(device, probe.wide(device)))


@cache
def _shared(device: str, wide: bool) -> ShadowTracer:
    return ShadowTracer("light_grid", "packed", device, Bounds(_MOST_TRIANGLES, _MOST_RAYS, 1, 64, 1))


def _scenes(name: str, seed: int) -> list[Any]:
    """(light, bias, (N, 3) samples, (T, 3, 3) triangles) of every scene."""
    rng = np.random.default_rng([466, seed])
    if name in LIGHTS:
        return [(LIGHTS[name], 0.02, *scene) for scene in _in_bundles(rng, name)]
    return [packed_grid.HARD[name](rng) for _ in range(4)]


def _in_bundles(rng: np.random.Generator, name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """All bundles together; and each alone, with more samples in it and more triangles through it."""
    rays, corners = all_bundles(rng, LIGHTS[name])
    scenes = [(rays.reshape(-1, 3), corners.reshape(-1, 3, 3))]
    lamp = LIGHTS[name].homogeneous
    for spread, points, triangles in zip(SPREADS, rays, corners, strict=True):
        between = rng.choice([0.0, 1.0, 0.5, 0.01], (576, 1)) * (points[rng.integers(0, 64, 576)] - points[0])
        more = np.concatenate([points, points[0] + between])
        parts = [triangles]
        if name == "inside":
            axis = points.mean(axis=0) - lamp[:3]
            for some in (bundles.edges_across, bundles.straddling):
                parts.append(lamp[:3] + some(rng, axis, spread + 1e-6, 16)[0].reshape(-1, 3, 3))
        scenes.append((more, np.concatenate(parts)))
    return scenes


def _rows(packed: Any, level: str) -> np.ndarray:
    """(B, 4) boxes of a level as the kernels take them."""
    boxes = packed.boxes[level]
    return np.column_stack([np.full(len(boxes.number), LEVELS.index(level)), boxes.number, boxes.group, boxes.column])


def _judge(tracer: ShadowTracer, scene: Any, hidden: np.ndarray) -> Any:
    """The answers for all boxes, by level: (B, T); and how many of the rays in each a triangle hides, and the rays."""
    light, bias, points, corners = scene
    count = len(corners)
    tracer.scene.put("mesh", corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    given, wide = probe_accelerators.binning(tracer, points, light, bias), probe.wide(tracer.device)
    frame, packed = make_light_frame(light, probe.anchor(tracer)), packed_grid.read(given.tiles)
    space = make_light_space(frame)
    if not hidden.size:
        hidden.resize((len(points), count), refcheck=False)
        out = wp.empty(hidden.shape, dtype=wp.uint8, device=tracer.device)
        context = probe.context(tracer)
        inputs = [wp.vec4d(*light.homogeneous), context.samples.positions]
        inputs += [context.scene.vertices, context.scene.triangles, out]
        wp.launch(decide_all, dim=hidden.shape, inputs=inputs, device=tracer.device)
        hidden[:] = out.numpy()
    tile, lane = np.nonzero(packed.live)
    position = np.full(len(packed.live), -1)
    position[packed.boxes["tile"].number] = np.arange(len(packed.boxes["tile"].number))
    result = {}
    for level, places in packed.places().items():
        boxes, rows = packed.boxes[level], _rows(packed, level)
        out = wp.empty((len(rows), count), dtype=int, device=tracer.device)
        inputs = [wp.array(rows, dtype=wp.vec4i, device=tracer.device)]
        inputs += [*given.alone, frame, space, given.tiles] if wide else [space, given.tiles, *given.alone]
        wp.launch(judge_all_wide if wide else judge_all, dim=out.shape, inputs=[*inputs, out], device=tracer.device)
        index = np.searchsorted(boxes.number, places[position[tile]])
        shadows, rays = np.zeros(out.shape, int), np.bincount(index, minlength=len(rows))
        np.add.at(shadows, index, hidden[packed.order[tile, lane]])
        result[level] = (out.numpy().copy(), shadows, rays[:, None])
    return result, bool(packed.aligned[0])


@cache
def _outcome(device: str, name: str, seed: int, form: str) -> list[Any]:
    with probe.form(form):
        tracer, scenes, hidden = _tracer(device), _scenes(name, seed), _hidden(device, name, seed)
        return [_judge(tracer, *each) for each in zip(scenes, hidden, strict=False)]


@cache
def _hidden(device: str, name: str, seed: int) -> list[np.ndarray]:
    """Of each scene, filled by whoever is first."""
    return [np.empty((0, 0), np.uint8) for _ in range(len(SPREADS) + 1)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", [*LIGHTS, *packed_grid.HARD])
@probe.in_both_forms
@pytest.mark.slow
def test_nothing_hidden_is_rejected_and_nothing_lit_covered(
    any_device: str, kernel_form: str, name: str, seed: int
) -> None:
    for number, (levels, _) in enumerate(_outcome(any_device, name, seed, kernel_form)):
        for level, (answers, shadows, rays) in levels.items():
            missed = (shadows > 0) & (answers < _MET)
            taken = (shadows < rays) & (answers == _COVERED)
            where = f"scene {number}, {level}s"
            assert not missed.any(), f"{where}: {answers[missed][:5]} for hidden rays of {np.argwhere(missed)[:3]}"
            assert not taken.any(), f"{where}: covered, with light at {np.argwhere(taken)[:3]}"


@pytest.mark.parametrize("name", LIGHTS)
@probe.in_both_forms
@pytest.mark.slow
def test_boxes_decide(any_device: str, kernel_form: str, name: str) -> None:
    """Most that may be rejected is, and much of what may be covered; each step has a share in it, on cube faces and in
    the aligned frustum."""
    share: Counter[Any] = Counter()
    modes: Counter[bool] = Counter()
    for seed in range(3):
        for levels, aligned in _outcome(any_device, name, seed, kernel_form):
            modes[aligned] += 1
            for level, (answers, shadows, rays) in levels.items():
                lit, dark = shadows == 0, shadows == rays
                share[level, "lit"] += int(lit.sum())
                share[level, "dark"] += int(dark.sum())
                share[level, "covered"] += int((answers == _COVERED).sum())
                for answer in (_ABSENT, _BESIDE, _UNTOUCHED, _MISSED):
                    share[level, answer] += int((answers == answer)[lit].sum())
    # Tiles from the image overlap in a column where sorted ones do not.
    usual = kernel_form == probe.USUAL
    for level, least_rejected, least_covered in (
        ("tile", 0.88, 0.78),
        ("block", 0.65, 0.6),
        ("column", 0.6 if usual else 0.65, 0.6),
    ):
        lit, dark = share[level, "lit"], share[level, "dark"]
        rejected = sum(share[level, answer] for answer in (_ABSENT, _BESIDE, _UNTOUCHED, _MISSED))
        assert rejected > least_rejected * lit > 2_000, (level, share)
        assert share[level, "covered"] > least_covered * dark > 300, (level, share)
    lit = share["tile", "lit"]
    assert min(share["tile", _ABSENT], share["tile", _MISSED]) > 0.05 * lit, share
    assert share["tile", _BESIDE] > (0.005 if name == "inside" else 0.08 if usual else 0.15) * lit, share
    assert share["tile", _UNTOUCHED] > 0.1 * lit, share
    assert modes[True] > 20 and (modes[False] > 10) == (name == "inside"), modes


def _judged_by_both(device: str, scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """The answers for all boxes of all levels that the usual form has packed: its own, and those of one lane."""
    light, bias, points, corners = scene
    given = {}
    for form in probe.FORMS:
        with probe.form(form):
            tracer = _tracer(device)
            tracer.scene.put("mesh", corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
            given[form] = probe_accelerators.binning(tracer, points, light, bias), probe.anchor(tracer)
    (usual, anchor), (cuda, other) = given[probe.USUAL], given[probe.CUDA]
    assert anchor == other, "the planes of the one are those of the other"
    frame, tiles, packed = make_light_frame(light, anchor), usual.tiles, packed_grid.read(usual.tiles)
    space = make_light_space(frame)
    rows = wp.array(np.concatenate([_rows(packed, level) for level in LEVELS]), dtype=wp.vec4i, device=device)
    answers = [wp.empty((len(rows), len(corners)), dtype=int, device=device) for _ in probe.FORMS]
    inputs = [rows, *usual.alone, frame, space, tiles, answers[0]]
    wp.launch(judge_all_wide, dim=answers[0].shape, inputs=inputs, device=device)
    wp.launch(judge_all, dim=answers[1].shape, inputs=[rows, space, tiles, *cuda.alone, answers[1]], device=device)
    return answers[0].numpy(), answers[1].numpy()


@pytest.mark.wide
@pytest.mark.parametrize("name", [*LIGHTS, *packed_grid.HARD])
@pytest.mark.slow
def test_sixteen_lanes_judge_as_one(any_device: str, name: str) -> None:
    """A box that neither leaves out before is judged alike, and triangles that cannot touch a face are the same but for
    those that are not among the candidates."""
    judged = 0
    for seed in range(3):
        for scene in _scenes(name, seed):
            wide, one = _judged_by_both(any_device, scene)
            both = (wide > _BESIDE) & (one > _BESIDE)
            np.testing.assert_array_equal(wide[both], one[both])
            assert not ((one == _ABSENT) & (wide != _ABSENT)).any()
            judged += int(both.sum())
    assert judged > 3_000, judged
