# SPDX-License-Identifier: Apache-2.0
"""Which points of a light with size reach each sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Bits = npt.NDArray[np.uint64]
Counts = npt.NDArray[np.uint16]

_ONES = np.array([bin(byte).count("1") for byte in range(256)], np.uint8)


def ones_of(bits: Bits) -> Counts:
    """How many bits are set in each number."""
    if hasattr(np, "bitwise_count"):  # from numpy 2 on
        counts: Counts = np.bitwise_count(bits).astype(np.uint16)
        return counts
    octets = np.ascontiguousarray(bits).view(np.uint8).reshape(*bits.shape, 8)
    return _ONES[octets].sum(axis=-1, dtype=np.uint16)


@dataclass(frozen=True)
class Reaching:
    """Points of a light that reach samples, for samples of any shape.

    Attributes:
        samples: points that the light has.
        bits: bit i is set where point i reaches; None of a light with more points than there are bits.
        counts: how many reach.
    """

    samples: int
    bits: Bits | None
    counts: Counts

    def shaped(self, shape: tuple[int, ...]) -> Reaching:
        """The same for samples of another shape."""
        bits = None if self.bits is None else self.bits.reshape(shape)
        return Reaching(self.samples, bits, self.counts.reshape(shape))

    @property
    def share(self) -> npt.NDArray[np.float32]:
        """The part of the light that reaches."""
        share: npt.NDArray[np.float32] = self.counts.astype(np.float32) / np.float32(self.samples)
        return share

    def differs(self, other: Reaching) -> npt.NDArray[np.bool_]:
        """Where not the same points reach, or not as many if they are not told apart."""
        differs: npt.NDArray[np.bool_] = self.counts != other.counts
        if self.bits is not None and other.bits is not None:
            differs |= self.bits != other.bits
        return differs
