# SPDX-License-Identifier: Apache-2.0
"""Pictures of what was found: hours of sun, and a day in which they fill in, with legends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.terrain.dataset import iso
from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import Code, TileResult

_LARGEST = 800  # pixels along an edge
_DIM = 0.35  # of the colours in shadow
_GREY = (0.55, 0.55, 0.55)
_MOST_FRAMES = 96
MOST_TIMES = 2000
"""Of a moving picture: more would not fit into memory."""


class Pictures:
    """Every n-th cell of a model, so that it fits into a picture.

    Args:
        plan: what is shown.
        title: over the pictures.
        moving: whether a moving one is wanted, which needs codes.
    """

    def __init__(self, plan: Plan, title: str, moving: bool) -> None:
        rows, columns = plan.grid.rows, plan.grid.columns
        self._plan, self._title = plan, title
        self._step = max(1, -(-max(rows, columns) // _LARGEST))
        shape = -(-rows // self._step), -(-columns // self._step)
        self._codes: npt.NDArray[np.uint8] = np.full(
            (len(plan.suns.stamps) if moving else 0, *shape), Code.UNKNOWN, np.uint8
        )
        self._hours = np.full(shape, np.nan)

    def put(self, window: Window, result: TileResult) -> None:
        """Take a tile."""
        step = self._step
        first = [-part.start % step for part in window]
        place = tuple(slice(-(-part.start // step), -(-part.stop // step)) for part in window)
        if len(self._codes):
            self._codes[:, place[0], place[1]] = result.codes[:, first[0] :: step, first[1] :: step]
        self._hours[place] = result.lit[first[0] :: step, first[1] :: step] / 3600.0

    def png(self, path: Path) -> None:
        """Hours of sun of each cell; grey where there is no height."""
        figure, image = self._figure(self._hours, "hours of direct sun [h]")
        figure.axes[0].set_title(self._title)
        image.set_clim(0.0, self._most())
        figure.savefig(path, dpi=100, format="png")

    def gif(self, path: Path, milliseconds: int = 120) -> None:
        """A frame for each time with the sun up, of which there are some, or of many for every n-th: hours of sun up to
        then, darker where it does not reach, grey where it is unknown."""
        from matplotlib import colormaps
        from PIL import Image

        suns = self._plan.suns
        up = suns.up()
        every = max(1, -(-len(up) // _MOST_FRAMES))
        figure, image = self._figure(self._hours, "hours of direct sun so far [h]")
        image.set_clim(0.0, self._most())
        so_far, pictures = np.zeros(self._hours.shape), []
        for number, k in enumerate(up):
            so_far += np.where(self._codes[k] == Code.LIT, suns.seconds[k] / 3600.0, 0.0)
            if number % every:
                continue
            colours = colormaps["inferno"](so_far / self._most())[..., :3]
            colours[(self._codes[k] == Code.TURNED_AWAY) | (self._codes[k] == Code.CAST_SHADOW)] *= _DIM
            colours[self._codes[k] == Code.UNKNOWN] = _GREY
            image.set_data(colours)
            text = f"{iso(suns.stamps[k])}  sun {suns.azimuth[k]:.0f}\N{DEGREE SIGN} from north"
            figure.axes[0].set_title(f"{text}, {suns.elevation[k]:.0f}\N{DEGREE SIGN} high", fontsize=9)
            figure.canvas.draw()
            frame = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
            pictures.append(frame.quantize(256))
        more = {"append_images": pictures[1:], "duration": milliseconds, "loop": 0}
        pictures[0].save(path, format="GIF", save_all=True, **more)

    def _most(self) -> float:
        return max(self._plan.suns.daylight / 3600.0, 1e-9)

    def _figure(self, values: npt.NDArray[np.float64], legend: str) -> tuple[Any, Any]:
        from matplotlib import colormaps
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        colours = colormaps["inferno"].with_extremes(bad=_GREY)
        grid, step = self._plan.grid, self._step
        down, right = (float(np.hypot(*each)) * step for each in (grid.row_step, grid.column_step))
        rows, columns = values.shape
        extent = (0.0, columns * right / 1000.0, rows * down / 1000.0, 0.0)
        image = axes.imshow(values, cmap=colours, interpolation="nearest", extent=extent)
        axes.set_xlabel("from the first column [km]")
        axes.set_ylabel("from the first row [km]")
        figure.colorbar(image, ax=axes, label=legend, shrink=0.9)
        return figure, image
