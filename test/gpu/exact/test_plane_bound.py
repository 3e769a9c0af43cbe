# SPDX-License-Identifier: Apache-2.0
"""The filter's bound of a triangle's own plane (docs/exactness.md, section 3): where it is sure, in any spelling, the
exact decision says the same, for starts within a few roundings of the plane; and bounds that are too small are found
out by the same pairs."""

from __future__ import annotations

import zlib
from typing import Any

import near_planes
import numpy as np
import oracle
import pytest

wp = pytest.importorskip("warp")

from shadow_tracer import Bounds  # noqa: E402
from shadow_tracer.gpu.device import native  # noqa: E402
from shadow_tracer.gpu.device.devices import pick_device  # noqa: E402
from shadow_tracer.gpu.exact import records as setup  # noqa: E402
from shadow_tracer.gpu.exact.decision import decide, filter_pair, ray_magnitude  # noqa: E402
from shadow_tracer.gpu.exact.light_frame import LightFrame, make_light_frame  # noqa: E402
from shadow_tracer.gpu.samples import rays  # noqa: E402
from shadow_tracer.gpu.samples.sample_set import SampleSet  # noqa: E402

_TRIANGLES = 3000
_EACH = near_planes.EACH
_RAYS = _TRIANGLES * _EACH
_NO, _YES, _MAYBE = 0, 1, 2
_TRUE = (setup.SLOPE_FACTOR, setup.OFFSET_FACTOR, setup.SETUP_ERROR)


@wp.kernel(enable_backward=False)
def _prepare(
    count: int,
    light: wp.array(dtype=LightFrame),
    factors: wp.vec3d,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    counts: wp.array(dtype=wp.vec2i),
):
    first = wp.tid() * setup.BLOCK
    setup.prepare_block(
        first,
        count,
        light[0],
        wp.float64(setup.FILTER_FACTOR),
        factors[0],
        factors[1],
        wp.float64(setup.U32),
        factors[2],
        wp.float64(setup.LARGEST_OFFSET),
        vertices,
        triangles,
        first,
        records,
        0,
        wp.tid(),
        counts,
    )


@wp.kernel(enable_backward=False)
def _decide(
    light: wp.array(dtype=LightFrame),
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    out: wp.array(dtype=int),
):
    i = wp.tid()
    t = i // 16
    out[i] = decide(samples[i], light[0].light, vertices[3 * t], vertices[3 * t + 1], vertices[3 * t + 2]) & 1


@wp.kernel(enable_backward=False)
def _ask_pair(
    rays: wp.array(dtype=wp.vec4), share: float, records: wp.array2d(dtype=wp.vec4), out: wp.array(dtype=int)
):
    i = wp.tid()
    out[i] = filter_pair(rays[i], share * ray_magnitude(rays[i]), records, i // 16)


_LANES = r"""
    float lanes[5][16];
    for (int j = 0; j < 16; ++j) {
        const wp::vec4 ray = rays.data[16 * triangle + j];
        for (int k = 0; k < 4; ++k)
            lanes[k][j] = ray[k];
        lanes[4][j] = share * (fabsf(ray[0]) + fabsf(ray[1]) + fabsf(ray[3]) + 0x1p-20f);
    }
    const float* record = (const float*)records.data + 16 * triangle;
"""


@wp.func_native(
    "#if !defined(__CUDA_ARCH__)\n"
    + native.snippet(
        "exact/filter.h@16",
        call=_LANES
        + """
    int yes = 0;
    const int found = Filter16::possible(record, lanes[0], yes);
    for (int j = 0; j < 16; ++j)
        out.data[16 * triangle + j] = found >> j & 1 ? 2 - (yes >> j & 1) : 0;
    """,
    )
    + "\n#endif\n"
)
def _sixteen(
    triangle: int,
    rays: wp.array(dtype=wp.vec4),
    share: float,
    records: wp.array2d(dtype=wp.vec4),
    out: wp.array(dtype=int),
): ...


@wp.kernel(enable_backward=False)
def _ask_sixteen(
    rays: wp.array(dtype=wp.vec4), share: float, records: wp.array2d(dtype=wp.vec4), out: wp.array(dtype=int)
):
    _sixteen(wp.tid(), rays, share, records, out)


_KERNELS = {"pair": _ask_pair, "sixteen": _ask_sixteen}


def _answers(rays: Any, records: Any, spelling: str, count: int, share: float = 1.0) -> np.ndarray:
    """The filter's, of ``count`` rays, sixteen for each record."""
    out = wp.zeros(count, dtype=int, device="cpu")
    dim = count if spelling == "pair" else count // _EACH
    wp.launch(_KERNELS[spelling], dim=dim, inputs=[rays, share, records, out], device="cpu")
    return out.numpy()


@pytest.fixture(scope="module")
def frame() -> SampleSet:
    bounds = Bounds(max_triangles=_TRIANGLES, max_rays=_RAYS, max_lights=1, queue_capacity=1)
    return SampleSet(bounds, pick_device("cpu"))


def _counts() -> Any:
    """Of each block of triangles, what casts nothing."""
    return wp.zeros(-(-_TRIANGLES // setup.BLOCK), dtype=wp.vec2i, device="cpu")


class _Judged:
    """Pairs of a family: ``hidden`` (T, 16) exactly; answers of the filter on demand."""

    def __init__(self, frame: SampleSet, pairs: near_planes.Pairs) -> None:
        self._frame, self.pairs = frame, pairs
        frame.positions.numpy()[:_RAYS] = pairs.samples.reshape(-1, 4)
        frame.valid.fill_(1)
        frame.set_samples(_RAYS, 0)
        frame.set_lights([make_light_frame(pairs.light, pairs.anchor)])
        rays.project(frame, 0, 0, 0)
        self._vertices = wp.array(pairs.corners.reshape(-1, 3), dtype=wp.vec3d, device="cpu")
        self._triangles = wp.array(np.arange(3 * _TRIANGLES).reshape(-1, 3), dtype=wp.vec3i, device="cpu")
        out = wp.zeros(_RAYS, dtype=int, device="cpu")
        wp.launch(
            _decide, dim=_RAYS, inputs=[frame.light_frame_of[0], frame.positions, self._vertices, out], device="cpu"
        )
        self.hidden = out.numpy().reshape(-1, _EACH).astype(bool)
        assert np.isfinite(frame.rays.numpy()[:_RAYS]).all()

    def scalar_records(self) -> Any:
        """As CUDA makes them."""
        records, counts = wp.empty((_TRIANGLES, 4), dtype=wp.vec4, device="cpu"), _counts()
        inputs = [self._frame.light_frame_of[0], setup.FILTER_FACTOR, self._vertices, self._triangles]
        wp.launch(
            setup.prepare_triangles,
            dim=_TRIANGLES,
            inputs=[0, *inputs, records, 0, counts],
            device="cpu",
        )
        return records

    def records(self, factors: tuple[float, float, float] = _TRUE) -> Any:
        """With these factors of m, of the offset and of float64's errors."""
        records, counts = wp.empty((_TRIANGLES, 4), dtype=wp.vec4, device="cpu"), _counts()
        inputs = [_TRIANGLES, self._frame.light_frame_of[0], wp.vec3d(*factors)]
        inputs += [self._vertices, self._triangles, records, counts]
        wp.launch(_prepare, dim=-(-_TRIANGLES // setup.BLOCK), inputs=inputs, device="cpu")
        return records

    def answers(self, records: Any, spelling: str = "pair", share: float = 1.0) -> np.ndarray:
        """(T, 16) of the filter, with this share of the magnitude."""
        return _answers(self._frame.rays, records, spelling, _RAYS, share).reshape(-1, _EACH)

    def wrong(self, answers: np.ndarray) -> np.ndarray:
        """(T, 16): sure, and not what the exact decision says."""
        return ((answers == _YES) & ~self.hidden) | ((answers == _NO) & self.hidden)


def _judged(frame: SampleSet, family: str, seed: int) -> _Judged:
    rng = np.random.default_rng([zlib.crc32(family.encode()), seed])
    return _Judged(frame, near_planes.FAMILIES[family](rng, _TRIANGLES))


@pytest.mark.parametrize("family", near_planes.FAMILIES)
@pytest.mark.slow
def test_what_the_filter_is_sure_of_is_so(frame: SampleSet, family: str) -> None:
    """A million pairs of each family at one lane and at sixteen, with the records of both set-ups."""
    sure, seeds = 0, 24
    for seed in range(seeds):
        judged = _judged(frame, family, seed)
        assert 0.1 < judged.hidden.mean() < 0.9
        records = judged.records()
        answers = judged.answers(records)
        assert not judged.wrong(answers).any()
        assert np.array_equal(judged.answers(records, "sixteen"), answers), "one text, two widths"
        assert not judged.wrong(judged.answers(judged.scalar_records())).any()
        sure += int((answers != _MAYBE).sum())
    assert sure > (0.02 if family == "needles" else 0.2) * seeds * _RAYS


@pytest.mark.parametrize("family", near_planes.FAMILIES)
def test_fractions_say_the_same(frame: SampleSet, family: str) -> None:
    """The sure pairs nearest to the plane, of those with each answer, against the oracle."""
    judged = _judged(frame, family, 0)
    pairs, records = judged.pairs, judged.records()
    answers = judged.answers(records)
    rays, plane = frame.rays.numpy()[:_RAYS].reshape(-1, _EACH, 4), records.numpy()[:_TRIANGLES, 3]
    distance = np.abs(np.einsum("tsx,tx->ts", rays[:, :, (0, 1, 3)], plane[:, :3]) - plane[:, None, 3])
    place, w = oracle.homogeneous_light(pairs.light)
    for answer in (_NO, _YES):
        there = np.argwhere(answers == answer)
        nearest = there[np.argsort(distance[answers == answer])[:300]]
        # No ray is surely inside of a needle.
        assert len(nearest) == (0 if (family, answer) == ("needles", _YES) else 300)
        for t, k in nearest:
            sample = pairs.samples[t, k]
            hidden, tie = oracle.pair_exact(sample[:3], pairs.corners[t], place, w, sample[3])
            assert tie or hidden == (answer == _YES), (t, k)


def test_w_is_no_part_of_the_bound(frame: SampleSet) -> None:
    """Next to the anchor W is about 1 and U, V and Z are nothing: planes are known as well as those are."""
    answers = np.stack([(j := _judged(frame, "at_the_anchor", seed)).answers(j.records()) for seed in range(3)])
    assert (answers != _MAYBE).mean() > 0.2


@pytest.mark.parametrize("spelling", _KERNELS)
def test_edges_keep_w(spelling: str) -> None:
    """A ray of W alone: half an edge's normal, and a bound just above and just below that; a plane that W, were it
    counted, would make uncertain."""
    rays = wp.full(16, wp.vec4(0.0, 0.0, 1.0, 0.0), dtype=wp.vec4, device="cpu")
    for error, expected in ((0.4, _YES), (0.6, _MAYBE)):
        edge = (0.0, 0.0, 0.5)
        record = [[*edge, error], [*edge, 2.0], [*edge, 0.0], [0.0, 0.0, 0.0, -1.0]]
        records = wp.array(np.array([record], np.float32), dtype=wp.vec4, device="cpu")
        assert (_answers(rays, records, spelling, 16) == expected).all(), error


def test_what_is_no_number_is_a_maybe_at_any_width() -> None:
    rng = np.random.default_rng(77)
    rays = rng.normal(size=(4000, 16, 4)).astype(np.float32)
    table = rng.normal(size=(4000, 4, 4)).astype(np.float32)
    table[:, :3, 3] = 1e-6
    odd = [np.nan, np.inf, -np.inf, 0.0, 3e38]
    for values in (rays, table):
        places = rng.random(values.shape) < 0.02
        values[places] = rng.choice(np.float32(odd), places.sum())
    given = wp.array(rays.reshape(-1, 4), dtype=wp.vec4, device="cpu")
    records = wp.array(table, dtype=wp.vec4, device="cpu")
    one, sixteen = (_answers(given, records, spelling, 64_000) for spelling in _KERNELS)
    assert np.array_equal(one, sixteen) and {*one} == {_NO, _YES, _MAYBE}
    clean = np.isfinite(rays).all(axis=2) & np.isfinite(table).all(axis=(1, 2))[:, None]
    assert (one.reshape(4000, 16)[~clean] == _MAYBE).any(), "none of them mattered"


_QUARTER = (0.25 * _TRUE[0], 0.25 * _TRUE[1], _TRUE[2])


@pytest.mark.parametrize(
    ("family", "factors", "share"),
    [
        ("aligned", _QUARTER, 1.0),
        ("aligned_through_the_anchor", _QUARTER, 1.0),
        ("aligned_through_the_anchor", _TRUE, 0.25),
        ("needles", (*_TRUE[:2], 0.0), 1.0),
    ],
    ids=["a quarter of the bound", "the same, no offset", "a quarter of the magnitude", "float64 taken as exact"],
)
def test_bounds_that_are_too_small_are_found_out(
    frame: SampleSet, family: str, factors: tuple[float, float, float], share: float
) -> None:
    """Half of the bound is still right: float32's errors hardly ever all point one way, nor is each as large as can be
    where the others are."""
    wrong = 0
    for seed in range(10):
        judged = _judged(frame, family, seed)
        wrong += int(judged.wrong(judged.answers(judged.records(factors), share=share)).sum())
    assert wrong > 10
