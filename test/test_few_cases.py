# SPDX-License-Identifier: Apache-2.0
"""The cases that the inner loop takes."""

from __future__ import annotations

import few_cases

_NAMES = [f"test_a.py::test_{function}[{case}-[x]]" for case in range(9) for function in ("one", "two")]
_ALONE = ["test_a.py::test_alone", "test_b.py::TestIt::test_one[0]"]


def test_each_function_has_a_few() -> None:
    kept = few_cases.choose([*_NAMES, *_ALONE], 4)
    for function in ("test_a.py::test_one[", "test_a.py::test_two["):
        assert sum(name.startswith(function) for name in kept) == 4
    assert set(_ALONE) <= set(kept)


def test_the_choice_does_not_depend_on_the_order() -> None:
    kept = few_cases.choose(_NAMES, 3)
    assert kept == [name for name in _NAMES if name in kept]
    assert set(few_cases.choose(_NAMES[::-1], 3)) == set(kept)


def test_functions_take_unlike_cases() -> None:
    kept = few_cases.choose([f"test_a.py::test_{k}[{case}]" for k in range(20) for case in range(9)], 2)
    assert {name.partition("[")[2] for name in kept} == {f"{case}]" for case in range(9)}
