# SPDX-License-Identifier: Apache-2.0
"""Intensities by direction, and IES files of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lamps import ies

from shadow_tracer import IntensityTable


def test_directions() -> None:
    """Down is 0, and horizontal angles grow counter-clockwise seen from above."""
    table = IntensityTable(
        (0.0, math.pi / 2), np.linspace(0.0, 2.0 * math.pi, 5), [[0, 1], [0, 2], [0, 3], [0, 4], [0, 1]]
    )
    ways = np.array(
        [(0, 0, -1), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (1, 1, 0), (1, -1, 0), (1, 0, -1), (1, 0, 1)]
    )
    ways = ways - np.array([0, 0, 1e-9])  # a level way may be rounded to one above the table
    assert table.towards(ways) == pytest.approx([0, 1, 2, 3, 4, 1.5, 2.5, 0.5, 0])
    turned = IntensityTable(table.vertical, table.horizontal, table.values, axis=(1, 0, 0), zero=(0, 0, 2))
    assert turned.towards(np.array([(1e-9, 0, 1), (1e-9, 1.0, 0)])) == pytest.approx([1, 2])


def test_power_of_what_is_known() -> None:
    angles = np.linspace(0.0, math.pi / 2, 200)
    lambert = IntensityTable(angles, (0.0,), [np.cos(angles)])
    assert lambert.power == pytest.approx(math.pi, rel=1e-4) and lambert.peak == 1.0
    ball = IntensityTable((0.0, math.pi), (0.0, 1.0, 2.0 * math.pi), np.ones((3, 2)))
    assert ball.power == pytest.approx(4.0 * math.pi, rel=1e-14)


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ({"vertical": (0.0,)}, "vertical: expected at least two"),
        ({"vertical": (1.0, 0.5)}, "vertical: expected ascending angles"),
        ({"vertical": (0.0, 90.0)}, "vertical: expected ascending angles from 0 to 3.14159"),
        ({"horizontal": (0.0, 1.0)}, r"horizontal: expected \(0.0,\), or angles from 0 to 2 pi"),
        ({"values": [[1.0]]}, r"values: expected shape \(1, 2\)"),
        ({"values": [[1.0, -1.0]]}, "values: expected intensities"),
        ({"values": [[0.0, 0.0]]}, "values: expected intensities"),
        ({"values": [[1.0, math.nan]]}, "values: expected finite numbers"),
        ({"values": [["1", "1"]]}, "values: expected real numbers"),
        ({"vertical": np.ma.masked_greater([0.0, 1.0], 0.5)}, "vertical: expected an array without masked values"),
        ({"axis": (0, 0, 0)}, "axis: expected a direction"),
        ({"zero": (0, 1, 1)}, "zero: expected a direction at right angles"),
        (
            {"horizontal": (0.0, 2.0 * math.pi), "values": [[1, 1], [1, 2]]},
            "values: expected the same at the horizontal angles 0 and 2 pi",
        ),
    ],
)
def test_tables_that_are_none(what: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        IntensityTable(**{"vertical": (0.0, 1.0), "horizontal": (0.0,), "values": [[1.0, 1.0]], **what})


def test_ies_files_are_read_in_the_unit_that_is_said(tmp_path: Path) -> None:
    pytest.importorskip("photompy")
    path = ies(tmp_path, multiplier=2.0, ballast=0.5)
    for unit, lumens, factor in (
        ("W/sr", None, 1.0),
        ("mW/sr", None, 1e-3),
        ("uW/cm2 at 1 m", None, 1e-2),
        ("cd", 300, 1 / 300),
    ):
        table = IntensityTable.from_ies(path, unit, lumens)
        assert table.values == pytest.approx(np.array([[100.0, 50.0, 0.0]]) * factor)
        assert table.vertical == pytest.approx([0.0, math.pi / 4, math.pi / 2])


def test_what_is_symmetric_in_an_ies_file_is_filled_in(tmp_path: Path) -> None:
    pytest.importorskip("photompy")
    quarter = IntensityTable.from_ies(ies(tmp_path, (0, 45, 90), [[9, 1, 0], [9, 2, 0], [9, 3, 0]]), "W/sr")
    assert quarter.horizontal == pytest.approx(np.radians(np.arange(0, 361, 45)))
    assert quarter.values[:, 1] == pytest.approx([1, 2, 3, 2, 1, 2, 3, 2, 1])
    half = IntensityTable.from_ies(ies(tmp_path, (0, 90, 180), [[9, 1, 0], [9, 2, 0], [9, 3, 0]]), "W/sr")
    assert half.values[:, 1] == pytest.approx([1, 2, 3, 2, 1])


def test_ies_files_that_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("photompy")
    path = ies(tmp_path)
    with pytest.raises(ValueError, match="unit: expected one of 'W/sr', 'mW/sr'"):
        IntensityTable.from_ies(path, "candela")
    with pytest.raises(ValueError, match="lumens_per_watt: candela need it"):
        IntensityTable.from_ies(path, "cd")
    with pytest.raises(ValueError, match="lumens_per_watt: belongs to the unit 'cd' alone"):
        IntensityTable.from_ies(path, "W/sr", 300.0)
    with pytest.raises(ValueError, match="path: expected an IES file"):
        IntensityTable.from_ies(tmp_path / "other.ies", "W/sr")
    (tmp_path / "broken.ies").write_text("IESNA:LM-63-2002\nTILT=NONE\n1 2\n")
    with pytest.raises(ValueError, match="path: expected a file of IES LM-63"):
        IntensityTable.from_ies(tmp_path / "broken.ies", "W/sr")
    with pytest.raises(ValueError, match="path: expected a file of photometric type C"):
        IntensityTable.from_ies(ies(tmp_path, kind=2), "W/sr")
    with pytest.raises(ValueError, match="path: expected horizontal angles of"):
        IntensityTable.from_ies(ies(tmp_path, (0, 30), [[9, 1, 0], [9, 2, 0]]), "W/sr")
