# SPDX-License-Identifier: Apache-2.0
"""What was found over a whole model, with names and units of the CF conventions."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import Code, TileResult

FloatArray = npt.NDArray[np.float64]

CODES = "0 lit, 1 turned away, 2 cast shadow, 3 unknown"


@dataclass(frozen=True)
class Layer:
    """A sum over the times: its name, and what CF says of it."""

    name: str
    standard_name: str
    long_name: str
    units: str
    of: str  # field of TileResult


LAYERS = (
    Layer("sunshine_duration", "duration_of_sunshine", "time for which the sun reaches", "s", "lit"),
    Layer("unknown_duration", "", "time for which it is unknown whether the sun reaches", "s", "unknown"),
    Layer("longest_darkness", "", "longest time on end not known to be lit, nights among it", "s", "darkness"),
    Layer(
        "direct_exposure",
        "integral_wrt_time_of_surface_direct_downwelling_shortwave_flux_in_air",
        "direct radiant exposure of the slope",
        "J m-2",
        "exposure",
    ),
    Layer("sunlit_fraction", "", "sunshine_duration by the time for which the sun is above the horizon", "1", ""),
)


def layers_of(result: TileResult, daylight: float) -> dict[str, FloatArray]:
    """(R, C) float64 of each layer, by its name."""
    found = {layer.name: getattr(result, layer.of) for layer in LAYERS if layer.of}
    nan = np.full_like(result.lit, np.nan)
    found["sunlit_fraction"] = result.lit / daylight if daylight > 0.0 else nan
    return found


class Gathered:
    """Results of tiles, put together in memory: 4 bytes for each cell and layer, one for each cell and time.

    Args:
        plan: what is answered.
        shape: rows and columns; None are those of the model.
    """

    def __init__(self, plan: Plan, shape: tuple[int, int] | None = None) -> None:
        shape = shape or (plan.grid.rows, plan.grid.columns)
        self._plan = plan
        self.codes: npt.NDArray[np.uint8] = np.full((len(plan.suns.stamps), *shape), Code.UNKNOWN, np.uint8)
        self.layers: dict[str, npt.NDArray[np.float32]] = {
            layer.name: np.full(shape, np.nan, np.float32) for layer in LAYERS
        }

    def put(self, window: Window, result: TileResult) -> None:
        """What was found of a tile."""
        self.codes[:, window[0], window[1]] = result.codes
        for name, values in layers_of(result, self._plan.suns.daylight).items():
            self.layers[name][window] = values


def iso(stamp: int) -> str:
    """Nanoseconds since 1970 as a UTC time of ISO 8601."""
    return datetime.fromtimestamp(stamp // 1_000_000_000, tz=timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def xarray() -> Any:
    """The module.

    Raises:
        ImportError: it is not installed; the message says how to.
    """
    try:
        return importlib.import_module("xarray")
    except ImportError as error:
        raise ImportError("a Dataset needs xarray: pip install 'shadow_tracer[terrain]'") from error


def dataset(gathered: Gathered, plan: Plan, coordinates: dict[str, Any], dims: tuple[str, str]) -> Any:
    """An xarray.Dataset of it all.

    Args:
        gathered: results of all tiles.
        plan: what they answer.
        coordinates: variables of xarray for the two dimensions.
        dims: their names.
    """
    suns = plan.suns
    stamps = np.array(suns.stamps, np.int64)
    half = np.rint(suns.seconds * 5e8).astype(np.int64)
    bounds = np.stack([stamps - half, stamps + half], axis=-1).astype("datetime64[ns]")
    ground = "the ground" if plan.above == 0.0 else f"a level plane {plan.above:g} m above the ground"
    codes = {
        "long_name": f"what the sun is to {ground}",
        "flag_values": np.array([int(code) for code in Code], np.uint8),
        "flag_meanings": " ".join(code.name.lower() for code in Code),
    }
    variables: dict[str, Any] = {"sun_code": (("time", *dims), gathered.codes, codes)}
    lit = (gathered.codes == Code.LIT).astype(np.uint8)
    variables["sunlit"] = (
        ("time", *dims), lit, {"standard_name": "sunlit_binary_mask", "units": "1"}
    )  # fmt: skip
    for layer in LAYERS:
        names = {"standard_name": layer.standard_name} if layer.standard_name else {}
        meta = {**names, "long_name": layer.long_name, "units": layer.units, "cell_methods": "time: sum"}
        if not layer.of or layer.name == "longest_darkness":
            del meta["cell_methods"]
        variables[layer.name] = (dims, gathered.layers[layer.name], meta)
    for name, values, standard, units, text in (
        ("solar_azimuth", suns.azimuth, "solar_azimuth_angle", "degree", "clockwise from true north"),
        ("solar_elevation", suns.elevation, "solar_elevation_angle", "degree", "apparent, with refraction"),
        ("direct_normal_irradiance", suns.irradiance, "surface_direct_along_beam_shortwave_flux_in_air", "W m-2",
         "at a right angle to the rays, as given"),
    ):  # fmt: skip
        variables[name] = ("time", values, {"standard_name": standard, "units": units, "comment": text})
    variables["time_bnds"] = (("time", "bnds"), bounds)
    times = ("time", stamps.astype("datetime64[ns]"), {"standard_name": "time", "bounds": "time_bnds"})
    attributes = {
        "Conventions": "CF-1.11",
        "comment": (
            f"sun_code: {CODES}. What is unknown counts as not lit: durations of sunshine, fractions and exposures are "
            "lower bounds, the longest darkness is an upper bound; unknown_duration says by how much."
        ),
    }
    found = xarray().Dataset(variables, coords={"time": times, **coordinates}, attrs=attributes)
    for name in ("time", "time_bnds"):  # CF wants the same units for both
        found[name].encoding = {
            "units": "seconds since 1970-01-01 00:00:00",
            "calendar": "standard",
            "dtype": "float64",
        }
    return found
