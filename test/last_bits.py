# SPDX-License-Identifier: Apache-2.0
"""Another numpy: the functions whose last bit is up to the library and the processor give the neighbouring number now
and then.

IEEE 754 says what + - * / and sqrt are to the last bit. It does not say so of sines, exponentials and normal deviates,
nor in which order a norm or a product of matrices is added up, and numpy, BLAS and libm choose by the processor they
find. A test that passes with ``--last-bits 1``, ``2`` and ``3`` does not depend on their choice. The same number always
gets the same neighbour, as with a real library; numbers with few digits, such as cos(0), stay what they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_FUNCTIONS = ("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "exp", "log", "log1p", "power", "hypot")
_PRODUCTS = ("dot", "einsum", "matmul", "inner", "tensordot")
_LINEAR = ("norm", "det", "inv", "solve")
_DEVIATES = ("normal", "standard_normal", "exponential")

_EXACT = {np.dtype(np.float64): (np.uint64, 24), np.dtype(np.float32): (np.uint32, 8)}


def neighbours(values: Any, seed: int) -> Any:
    """``values``, of float64 or float32, of which two thirds are replaced by the next number above or below; others as
    they are."""
    array = np.asarray(values)
    if array.dtype not in _EXACT or array.size == 0:
        return values
    kind, digits = _EXACT[array.dtype]
    flat = np.ascontiguousarray(array).reshape(-1)
    bits = flat.view(kind)
    mixed = (bits.astype(np.uint64) + np.uint64(seed)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(31))) * np.uint64(0xBF58476D1CE4E5B9)
    step = (mixed >> np.uint64(40)) % np.uint64(3)
    long = np.isfinite(flat) & (bits & kind((1 << digits) - 1) != 0)
    moved = flat.copy()
    for number, towards in ((0, -np.inf), (2, np.inf)):
        chosen = long & (step == number)
        moved[chosen] = np.nextafter(flat[chosen], array.dtype.type(towards))
    return moved.reshape(array.shape) if isinstance(values, np.ndarray) else moved[0]


class _Other:
    """A function of numpy with other last bits; all else, such as the methods of a ufunc, is numpy's."""

    def __init__(self, function: Any, seed: int) -> None:
        self._function, self._seed = function, seed

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        result = self._function(*args, **kwargs)
        return result if kwargs.get("out") is not None else neighbours(result, self._seed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._function, name)


def install(seed: int) -> None:
    """Replace them in this process."""

    class Generator(np.random.Generator):
        pass

    for name in _DEVIATES:
        method = getattr(np.random.Generator, name)
        setattr(Generator, name, lambda self, *args, _method=method, **kw: neighbours(_method(self, *args, **kw), seed))

    def default_rng(start: Any = None) -> np.random.Generator:
        return start if isinstance(start, np.random.Generator) else Generator(np.random.PCG64(start))

    for module, names in ((np, (*_FUNCTIONS, *_PRODUCTS)), (np.linalg, _LINEAR)):
        for name in names:
            setattr(module, name, _Other(getattr(module, name), seed))
    np.random.default_rng = default_rng  # type: ignore[assignment]
