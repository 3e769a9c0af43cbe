# SPDX-License-Identifier: Apache-2.0
"""Intensities of lights from IES files, which parameters name. No ROS here."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from shadow_tracer import IntensityTable
from shadow_tracer.ros.parameters.parameter_rows import ParameterError
from shadow_tracer.ros.wire.mesh_files.names import locate


def table_of(light: str, where: str, unit: str, lumens_per_watt: float) -> IntensityTable:
    """What an IES file says of a light, in the light's own frame: vertical angles from -z, horizontal ones from x.

    Args:
        light: its name.
        where: a path, ``~/...``, ``file://`` or ``package://<name>/...``.
        unit: what the file's numbers are, as for :meth:`IntensityTable.from_ies`.
        lumens_per_watt: for ``"cd"`` alone; 0 is none.

    Raises:
        ParameterError: there is no such file, it cannot be read, the unit is missing, or the library is.
    """
    group = f"lights.{light}.ies"
    try:
        path = locate(where, f"{group}.file")
        return _read(path, path.stat().st_mtime_ns, unit, lumens_per_watt or None)
    except (ImportError, OSError) as error:
        raise ParameterError(f"{group}.file: {error}") from error
    except ValueError as error:
        text = str(error)
        for field, name in (("path", "file"), ("unit", "unit"), ("lumens_per_watt", "lumens_per_watt")):
            if text.startswith(f"{field}: "):
                raise ParameterError(f"{group}.{name}: {text.partition(': ')[2]}") from error
        raise ParameterError(text if text.startswith(group) else f"{group}.file: {text}") from error


@lru_cache(maxsize=64)
def _read(path: Path, _changed: int, unit: str, lumens_per_watt: float | None) -> IntensityTable:
    """The same table for the same file, so that a light whose other parameters are set again stays the same light."""
    return IntensityTable.from_ies(path, unit, lumens_per_watt)
