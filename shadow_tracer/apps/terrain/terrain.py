# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer terrain DEM.tif --date 2026-06-21 -o sun.tif`: hours of sun of an elevation model, without ROS."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from shadow_tracer.apps.fleet.engines import add_options as add_engine
from shadow_tracer.apps.fleet.engines import check_options as check_engine
from shadow_tracer.apps.fleet.files import Busy, only_one
from shadow_tracer.apps.terrain.days import day_of, irradiance_of, seconds_of, times_of, zone_of
from shadow_tracer.apps.terrain.georeference import Georeference, TerrainError, locate
from shadow_tracer.apps.terrain.reading import NO_ZARR, Model, open_model
from shadow_tracer.terrain.plan import Plan, make_plan
from shadow_tracer.terrain.sunlight import BEYOND, check_options
from shadow_tracer.terrain.suns import SOLAR_CONSTANT, suns

if TYPE_CHECKING:
    from shadow_tracer.apps.fleet.engines import Engine
    from shadow_tracer.apps.terrain.pictures import Pictures
    from shadow_tracer.apps.terrain.run import Parts
    from shadow_tracer.apps.terrain.writing import NetCdfOutput, TiffOutput, ZarrOutput

_TIFF = ".tif", ".tiff"
_OUTPUTS = "output", "codes", "png", "gif"
NEEDED = ("ephem", "h5netcdf", "h5py", "matplotlib", "PIL", "rasterio", "rich", "xarray")

_DESCRIPTION = """\
When and how long the sun reaches each cell of an elevation model: hours of sun, longest darkness, direct exposure of
the slope, the share of the day, and with --codes what it is at each time: 0 lit, 1 turned away, 2 cast shadow,
3 unknown. Heights are metres at centres of cells, between them are triangles, and whether these hide the sun's centre
is decided exactly. Cells without a height, and what lies beyond the model, could be as high as its highest height: a
cell that this would hide is unknown, and counts as not lit."""

_EXIT_CODES = """exit code:
  0  the files were written
  1  they were not, for the reason given
  2  a package that is missing, or another run is at work on the same output
  130  interrupted; the same command goes on where it was"""

_EXAMPLE = """\
example:
  shadow_tracer terrain DEM.tif --date 2026-06-21 --every 15min --tz Europe/Zurich -o sun.tif --gif day.gif"""


def missing() -> str:
    """What is not installed and how to get it; empty if all is there."""
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    return f"terrain needs {', '.join(absent)}: pip install 'shadow_tracer[terrain]'" if absent else ""


def perform(chosen: argparse.Namespace) -> int:
    """Do what the options ask for. Returns the exit code.

    Raises:
        TerrainError: a file cannot be read, used or written.
        ValueError: an option is bad.
        ImportError, RuntimeError: the tracer cannot be made.
    """
    from shadow_tracer.apps.terrain.run import LOCK, Parts, Shared, key_of, run

    start = time.monotonic()
    stamps = _times(chosen)
    irradiance = irradiance_of(chosen.irradiance, stamps)
    memory = chosen.memory * 1e9
    check_options(chosen.height_above, chosen.beyond, chosen.tile, memory)
    _check_outputs(chosen, len(stamps))
    check_engine(chosen)
    if chosen.threads is not None and chosen.threads < 1:
        raise ValueError(f"--threads: expected at least 1, got {chosen.threads}")
    # Whoever does the tiles may stand in another folder.
    model = open_model(chosen.dem.absolute(), chosen.band, chosen.variable, chosen.resolution, chosen.nodata)
    given = _given(chosen)
    where = locate(chosen.dem.name, model.shape, model.transform, model.crs, given, chosen.curvature)
    sky = suns(stamps, where.place, seconds_of(chosen.every), irradiance)
    if chosen.gif and not sky.up():
        raise ValueError("--gif: expected times with the sun above the horizon, got none")
    plan = make_plan(where.grid, sky, model.source.read, chosen.tile, memory, chosen.height_above, chosen.beyond)
    if math.isnan(plan.ceiling):
        raise TerrainError(f"{chosen.dem.name}: heights: there is none, all of it is nodata")
    for line in _warnings(plan):
        print(f"warning: {line}", file=sys.stderr)
    options = (chosen.band, chosen.variable, chosen.resolution, chosen.nodata)
    folder = chosen.output.with_name(chosen.output.name + ".parts")
    with only_one(folder / LOCK):
        parts = Parts(folder, key_of(plan, chosen.dem, *options), chosen.restart)
        shared = Shared(plan, model.source, chosen.device, _threads(chosen))
        engine = _engine(chosen, parts)
        before = _with_progress(len(plan.tiles), lambda done: run(shared, parts, engine, done))
        _write(chosen, plan, where, model, parts)
        parts.remove()
    _summarise(chosen, plan, where, before, time.monotonic() - start)
    return 0


def _engine(chosen: argparse.Namespace, parts: Parts) -> Engine | None:
    """Who does the tiles; None is this process."""
    from shadow_tracer.apps.fleet.engines import engine_of
    from shadow_tracer.apps.terrain.run import answer

    if chosen.engine == "local" and chosen.jobs == 1:
        return None
    return engine_of(chosen, chosen.jobs, answer, bool, parts.known)


def _threads(chosen: argparse.Namespace) -> int | None:
    """Cores that each worker keeps busy; None is all of them."""
    if chosen.threads is not None or chosen.engine == "dask":
        return chosen.threads or 1
    return None if chosen.jobs == 1 else max(1, len(os.sched_getaffinity(0)) // chosen.jobs)


def _write(chosen: argparse.Namespace, plan: Plan, where: Georeference, model: Model, parts: Parts) -> None:
    """Make the files of all tiles."""
    from shadow_tracer.apps.terrain.run import results
    from shadow_tracer.apps.terrain.writing import whole

    with ExitStack() as stack:
        # All files get their names at the end: none is in the way of the same command if this is interrupted.
        paths = {name: getattr(chosen, name) for name in _OUTPUTS}
        new = {name: stack.enter_context(whole(path)) for name, path in paths.items() if path is not None}
        pictures = _pictures(chosen, plan)
        sinks = [_output(chosen, new, plan, where, model, stack).put, *([pictures.put] if pictures else [])]
        for window, result in results(plan, parts):
            for put in sinks:
                put(window, result)
        if pictures and chosen.png:
            pictures.png(new["png"])
        if pictures and chosen.gif:
            pictures.gif(new["gif"])


def _times(chosen: argparse.Namespace) -> list[int]:
    first = day_of(chosen.date, "--date")
    last = day_of(chosen.until, "--until") if chosen.until else first
    return times_of(first, last, seconds_of(chosen.every), zone_of(chosen.tz))


def _given(chosen: argparse.Namespace) -> tuple[float, float] | None:
    if (chosen.latitude is None) != (chosen.longitude is None):
        raise ValueError("--latitude: expected together with --longitude")
    return None if chosen.latitude is None else (chosen.latitude, chosen.longitude)


def _check_outputs(chosen: argparse.Namespace, times: int) -> None:
    from shadow_tracer.apps.terrain.pictures import MOST_TIMES
    from shadow_tracer.apps.terrain.writing import MOST_BANDS

    if chosen.gif and times > MOST_TIMES:
        raise ValueError(f"--gif: expected at most {MOST_TIMES} times, got {times}")
    if chosen.output.suffix not in (*_TIFF, ".nc", ".zarr"):
        raise ValueError(f"-o: expected *.tif, *.nc or *.zarr, got {chosen.output}")
    if chosen.output.suffix == ".zarr" and importlib.util.find_spec("zarr") is None:
        raise ValueError(f"-o: {NO_ZARR}")
    if chosen.cog and chosen.output.suffix not in _TIFF:
        raise ValueError("--cog: expected an output of *.tif")
    if chosen.codes and not {chosen.output.suffix, chosen.codes.suffix} <= set(_TIFF):
        raise ValueError("--codes: expected *.tif, beside an output of *.tif (a *.nc or *.zarr has them already)")
    if chosen.codes and times > MOST_BANDS:
        raise ValueError(f"--codes: expected at most {MOST_BANDS} times, bands of a GeoTIFF, got {times}")
    seen: set[Path] = set()
    for name in _OUTPUTS:
        path = getattr(chosen, name)
        if path is None:
            continue
        if path.resolve() in seen:
            raise ValueError(f"--{name}: expected another file than those of the other options, got {path}")
        seen.add(path.resolve())
        if path.exists() and chosen.dem.exists() and path.samefile(chosen.dem):
            raise TerrainError(f"{path}: is the model that is read; choose another name")
        if path.exists() and not chosen.overwrite:
            raise TerrainError(f"{path}: exists; choose another name, or --overwrite")
        if not path.parent.is_dir():
            raise TerrainError(f"{path}: there is no folder {path.parent}")


def _warnings(plan: Plan) -> list[str]:
    if not plan.short:
        return []
    up = sorted(float(plan.suns.elevation[k]) for k in plan.suns.up())
    below = up[min(plan.short, len(up) - 1)]
    return [
        f"--memory: too small to look as far as suns below {below:.2f} degrees need, {plan.short} of {len(up)}: where "
        "what lies beyond could hide these, cells are unknown at these times"
    ]


def _with_progress(tiles: int, work: Callable[[Callable[[int], None]], int]) -> int:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("tiles"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("tiles", total=tiles)
        return work(lambda count: progress.advance(task, count))


def _output(
    chosen: argparse.Namespace, new: dict[str, Path], plan: Plan, where: Georeference, model: Model, stack: ExitStack
) -> NetCdfOutput | TiffOutput | ZarrOutput:
    """What takes the tiles; all is written to the paths ``new`` when the stack is closed."""
    from shadow_tracer.apps.terrain.writing import NetCdfOutput, TiffOutput, ZarrOutput

    if chosen.output.suffix == ".nc":
        return stack.enter_context(NetCdfOutput(new["output"], plan, where))
    if chosen.output.suffix == ".zarr":
        return stack.enter_context(ZarrOutput(new["output"], plan, where, chosen.tile))
    return stack.enter_context(TiffOutput(new["output"], new.get("codes"), plan, where, model.point, chosen.cog))


def _pictures(chosen: argparse.Namespace, plan: Plan) -> Pictures | None:
    """What takes the tiles for pictures, if any are wanted."""
    from shadow_tracer.apps.terrain.pictures import Pictures

    if chosen.png is None and chosen.gif is None:
        return None
    days = chosen.date if not chosen.until else f"{chosen.date} to {chosen.until}"
    return Pictures(plan, f"{chosen.dem.name}, {days}", chosen.gif is not None)


def _summarise(chosen: argparse.Namespace, plan: Plan, where: Georeference, before: int, seconds: float) -> None:
    grid, place, sky = plan.grid, where.place, plan.suns
    strength = " to ".join(f"{each:g}" for each in sorted({sky.irradiance.min(), sky.irradiance.max()}))
    down, right = (math.hypot(*step) for step in (grid.row_step, grid.column_step))
    print(f"{grid.rows} x {grid.columns} cells of {down:.4g} x {right:.4g} m around latitude {place.latitude:.4f}, "
          f"longitude {place.longitude:.4f}")  # fmt: skip
    print(f"{len(sky.stamps)} times, {len(sky.up())} with the sun up, {sky.daylight / 3600:.2f} h; direct irradiance "
          f"{strength} W/m2 at a right angle to the rays")  # fmt: skip
    resumed = f", {before} of them from the run before" if before else ""
    print(f"{len(plan.tiles)} tiles{resumed}, {seconds:.1f} s")
    for name in _OUTPUTS:
        if getattr(chosen, name) is not None:
            print(getattr(chosen, name))


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="shadow_tracer terrain",
        description=_DESCRIPTION,
        epilog=f"{_EXIT_CODES}\n\n{_EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("dem", type=Path, metavar="DEM", help="a GeoTIFF or another raster of GDAL, a .npy, a .nc or a .zarr")
    add("-o", "--output", type=Path, required=True, metavar="OUT", help="*.tif: sums; *.nc, *.zarr: all of it")
    add("--codes", type=Path, metavar="FILE", help="*.tif: a band of codes for each time")
    add("--cog", action="store_true", help="make *.tif cloud-optimised: with overviews, to be read over a network")
    add("--png", type=Path, metavar="FILE", help="a picture of the hours of sun")
    add("--gif", type=Path, metavar="FILE", help="the day as a moving picture")
    add("--date", required=True, metavar="DAY", help="a day such as 2026-06-21, from midnight to midnight")
    add("--until", metavar="DAY", help="the last of several days (default: the day itself)")
    add("--every", default="15min", metavar="STEP", help="30s, 15min, 1h: from time to time (default: %(default)s)")
    add("--tz", default="UTC", metavar="ZONE", help="whose midnight: Europe/Zurich, +02:00 (default: %(default)s)")
    add("--height-above", type=float, default=0.0, metavar="M", help="of the points over the ground [m] (default: 0)")
    strength = (
        "direct, at a right angle to the rays: a number [W/m2], or a CSV file of times and numbers (default: "
        "%(default)s, the sun without an atmosphere)"
    )
    add("--irradiance", default=f"{SOLAR_CONSTANT:g}", metavar="W", help=strength)
    outside = "what is beyond the model: up to its highest height, or nothing (default: %(default)s)"
    add("--beyond", choices=BEYOND, default=BEYOND[0], help=outside)
    add("--curvature", action="store_true", help="of the Earth, for models of 10 to 100 km around their centre")
    add("--band", type=int, metavar="N", help="of a raster with several")
    add("--variable", default="", metavar="NAME", help="of a .nc or .zarr with several")
    add("--resolution", type=float, metavar="M", help="of the cells of a .npy [m], whose rows go south")
    add("--nodata", type=float, metavar="Z", help="the height in a .npy that says that there is none")
    add("--latitude", type=float, metavar="DEG", help="of the centre, where the file does not say it")
    add("--longitude", type=float, metavar="DEG", help="of the centre, east positive")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: %(default)s)")
    share = "cores that each keeps busy (default: by --jobs; with --engine dask 1)"
    add("--threads", type=int, metavar="N", help=share)
    add_engine(parser)
    add("--tile", type=int, default=1024, metavar="CELLS", help="along an edge of a tile (default: %(default)s)")
    add("--memory", type=float, default=2.0, metavar="GB", help="for a tile, in each process (default: %(default)g)")
    add("--device", help="cpu or cuda:N (default: the first CUDA device, or the CPU)")
    add("--restart", action="store_true", help="throw away tiles of a run that was interrupted")
    add("--overwrite", action="store_true", help="replace files that exist")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Returns the exit code, which ``--help`` explains."""
    chosen = _options().parse_args(arguments)
    if text := missing():
        print(text, file=sys.stderr)
        return 2
    try:
        return perform(chosen)
    except KeyboardInterrupt:
        print("terrain: interrupted; the same command goes on where it was", file=sys.stderr)
        return 130
    except (Busy, TerrainError, ValueError, RuntimeError, ImportError, OSError) as error:
        print(f"terrain: {error}", file=sys.stderr)
        return 2 if isinstance(error, (Busy, ImportError)) else 1


if __name__ == "__main__":
    sys.exit(main())
