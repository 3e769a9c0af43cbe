# SPDX-License-Identifier: Apache-2.0
"""What goes up in pieces and comes down packed is, bit for bit, what was sent; a GPU's ways also on the CPU."""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
import pytest
import warp as wp

from shadow_tracer import Bounds
from shadow_tracer.gpu.device.transfers import HostCopies, Uploads
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.gpu.visibility.packed_states import PackedStates, words_of
from shadow_tracer.gpu.visibility.planes import StatePlanes
from shadow_tracer.visibility import Frame, State

_KINDS: list[tuple[Any, Any, tuple[int, ...]]] = [
    (wp.uint8, np.uint8, ()),
    (wp.uint16, np.uint16, ()),
    (wp.float32, np.float32, ()),
    (wp.vec3i, np.int32, (3,)),
    (wp.vec3d, np.float64, (3,)),
    (wp.vec4d, np.float64, (4,)),
]


@pytest.mark.parametrize("places", [1, 2, 4])
@pytest.mark.parametrize("kind", _KINDS, ids=lambda kind: kind[0].__name__)
def test_pieces_arrive_where_they_belong(any_device: str, kind: tuple[Any, Any, tuple[int, ...]], places: int) -> None:
    """Fewer, as many and more elements than a piece holds; what lies beside them stays, and the source may change."""
    dtype, scalar, shape = kind
    device, rng = wp.get_device(any_device), np.random.default_rng(4)
    uploads = Uploads(device, piece=96, places=places, staged=True)
    size = wp.types.type_size_in_bytes(dtype)
    for count in (1, 96 // size, 96 // size + 1, 7 * (96 // size) + 3):
        array = wp.zeros(count + 9, dtype=dtype, device=device)
        source = rng.integers(1, 200, (count, *shape)).astype(scalar)
        sent = source.copy()
        uploads(array, source, offset=5)
        source[:] = 0
        got = array.numpy()
        np.testing.assert_array_equal(got[5 : 5 + count], sent)
        assert not got[:5].any() and not got[5 + count :].any()


def test_nothing_is_copied_of_nothing(any_device: str) -> None:
    device = wp.get_device(any_device)
    array = wp.full(3, 7, dtype=int, device=device)
    for staged in (False, True) if device.is_cpu else (True,):
        Uploads(device, staged=staged)(array, np.empty(0, np.int32), offset=2)
    np.testing.assert_array_equal(array.numpy(), 7)


def test_elements_of_another_size_are_refused(any_device: str) -> None:
    """Bytes are copied as they are: a source of another type would be read beyond its end, or in part."""
    array = wp.zeros(8, dtype=wp.vec3d, device=any_device)
    with pytest.raises(ValueError, match="source: expected 4 elements of 24 bytes, got 48 bytes"):
        Uploads(wp.get_device(any_device), staged=True)(array, np.ones((4, 3), np.float32))


def test_the_host_reads_what_was_fetched(any_device: str) -> None:
    """Copies change when they are fetched and not before; without copies the array itself is read."""
    device = wp.get_device(any_device)
    for mirrored in (False, True):
        host = HostCopies(device, mirrored)
        numbers, longer = host.add(wp.zeros(3, dtype=int, device=device)), wp.zeros(10, dtype=int, device=device)
        host.add(longer, whole=False)
        numbers.fill_(5)
        longer.fill_(6)
        assert host.read(numbers).tolist() == ([0] * 3 if mirrored else [5] * 3)
        host.fetch(longer, 4)
        assert host.read(numbers).tolist() == [5] * 3
        assert host.read(longer).tolist() == ([6] * 4 + [0] * 6 if mirrored else [6] * 10)


def test_copies_go_with_their_arrays(any_device: str) -> None:
    """Of a pipeline that is no longer used, for instance; a copy is one, however often an array is added."""
    device = wp.get_device(any_device)
    host = HostCopies(device, mirrored=True)
    kept = host.add(host.add(wp.full(2, 7, dtype=int, device=device)))
    for _ in range(5):
        host.add(wp.zeros(1000, dtype=int, device=device))
    gc.collect()
    host.fetch(kept, 1)
    assert host.read(kept).tolist() == [7, 7]
    assert len(host._copies) == 1


@pytest.mark.parametrize("lights", [1, 3])
@pytest.mark.parametrize("count", [1, 31, 32, 33, 100, 1023])
def test_packed_states_are_the_states(any_device: str, count: int, lights: int) -> None:
    rng = np.random.default_rng(count)
    bounds = Bounds(max_triangles=1, max_rays=1100, max_lights=3, queue_capacity=1, grid_entries=1)
    frame = SampleSet(bounds, wp.get_device(any_device), mirrored=True)
    planes = StatePlanes(frame)
    kept = []
    for _ in range(3):  # those of a frame before stay what they were
        states = rng.integers(0, 4, (lights, count)).astype(np.uint8)
        states[:, states[0] == State.INVALID] = State.INVALID
        frame.set_samples(count, 0)
        frame.upload(frame.states, states.reshape(-1))
        planes.pack(lights)
        planes.fetch(lights)
        kept.append((states, planes.read(lights)))
    for states, packed in kept:
        np.testing.assert_array_equal(packed.invalid(), (states == State.INVALID).all(axis=0))
        np.testing.assert_array_equal(packed.lit_by_any(), (states == State.LIT).any(axis=0))
        for light in range(lights):
            np.testing.assert_array_equal(packed.lit(light), states[light] == State.LIT)
        np.testing.assert_array_equal(packed.bytes, states)
    assert planes.nbytes() == 3 * 2 * 4 * words_of(1100)


def test_a_frame_of_packed_states_is_the_frame() -> None:
    """Masks, bits and comparisons, whichever way the states came."""
    rng, shape = np.random.default_rng(8), (13, 7)
    states = rng.integers(0, 3, (3, 91)).astype(np.uint8)
    states[:, rng.random(91) < 0.2] = State.INVALID
    words = words_of(91)
    planes = np.zeros((3, 2, 4 * words), np.uint8)
    for bit in (0, 1):
        octets = np.packbits((states >> bit) & 1, axis=1, bitorder="little")
        planes[:, bit, : octets.shape[1]] = octets
    names = ("a", "b", "c")
    packed = Frame(names, shape, PackedStates(planes.view(np.uint32), 91), {}, {})
    plain = Frame(names, shape, states, {}, {})
    for unknown in (0, 77):
        for name in (None, *names):
            expected = plain.mask(name, unknown)
            assert set(np.unique(expected)) == ({0, 255} | {unknown})
            np.testing.assert_array_equal(packed.mask(name, unknown), expected)
    np.testing.assert_array_equal(packed.bits(), plain.bits())
    for name in names:
        np.testing.assert_array_equal(packed.state(name), plain.state(name))
        np.testing.assert_array_equal(packed.visibility(name), plain.visibility(name))
    assert packed.differing(plain) == plain.differing(packed) == 0
    for frame in (packed, plain):
        with pytest.raises(ValueError, match=r"name: expected one of \['a', 'b', 'c'\], got 'd'"):
            frame.mask("d")
