# SPDX-License-Identifier: Apache-2.0
"""DoseMap: how much radiation the surface of a part has received, texel by texel, while everything moves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shadow_tracer.dose_files import read_npz, write_csv, write_mesh, write_npz
from shadow_tracer.dose_picture import draw
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray, real
from shadow_tracer.scene.dose_colors import check_dose
from shadow_tracer.scene.frame_checks import Lights, check_lights
from shadow_tracer.scene.irradiance import check_strengths
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Mesh
from shadow_tracer.scene.texels import SIDES, Texels, cut, mesh_key
from shadow_tracer.tracer import ShadowTracer


@dataclass(frozen=True)
class _Received:
    """All that grows, in one object: an exposure is a single assignment, which has happened or not."""

    dose: FloatArray
    seconds_lit: FloatArray
    irradiance: FloatArray
    seconds: float


class DoseMap:
    """Dose (radiant exposure) [J/m2] on the surface of a part of a scene.

    The surface is cut into texels: triangles with edges of at most ``max_edge``, halved from those of the mesh. Each is
    asked about at its centre, ``offset`` off the surface. They move with the part's pose; the part's triangles and
    vertices stay, else the map belongs to another surface and says so.

    The same bits come from every pipeline, with lights in any order and any number of threads: irradiance is summed
    over lights in ascending order of their names, in float64. What is unknown (inside a lamp) adds no dose.

    Args:
        tracer: whose scene holds the part, and all that casts shadows on it.
        part: name of a mesh of the scene.
        max_edge: longest edge of a texel, positive [m].
        offset: how far in front of the surface texels are asked about [m], 0 or more; so that rounding does not put
            them behind their own triangle.
        side: "front" of the surface, from which corners are seen counter-clockwise; "back"; or "both": then each place
            has two texels, and the areas add up to twice that of the part.
        samples: name of the tracer's set of samples that is used; see :meth:`ShadowTracer.trace`.

    Raises:
        ValueError: an argument is malformed; the message names it and the allowed values.
    """

    def __init__(
        self,
        tracer: ShadowTracer,
        part: str,
        max_edge: float = 0.05,
        offset: float = 1e-3,
        side: str = "front",
        samples: str = "",
    ) -> None:
        _check_tracer(tracer)
        if part not in tracer.scene:
            raise ValueError(f"part: expected one of {list(tracer.scene.names)}, got {part!r}")
        edge, lift = real(max_edge), real(offset)
        if not 0.0 < edge < np.inf:
            raise ValueError(f"max_edge: expected a positive length in metres, got {max_edge!r}")
        if not 0.0 <= lift < np.inf:
            raise ValueError(f"offset: expected a length in metres of 0 or more, got {offset!r}")
        if side not in SIDES:
            raise ValueError(f"side: expected one of {', '.join(map(repr, SIDES))}, got {side!r}")
        mesh = tracer.scene[part]
        texels = cut(mesh, edge, side)
        self._set_up(tracer, part, edge, lift, side, samples, texels, mesh_key(mesh.vertices, mesh.triangles))

    def _set_up(
        self,
        tracer: ShadowTracer | None,
        part: str,
        max_edge: float,
        offset: float,
        side: str,
        samples: str,
        texels: Texels,
        key: str,
    ) -> None:
        self.part, self.max_edge, self.offset, self.side = part, max_edge, offset, side
        self.tracer, self._samples, self._key = tracer, samples, key
        self._known: tuple[int, int] | None = None  # revisions of the mesh that was last found to be the same
        for array in (texels.corners, texels.area, texels.normals):
            array.setflags(write=False)
        self._texels = texels
        self._lifted = texels.centres + offset * texels.normals
        self.reset()

    def reset(self) -> None:
        """No dose anywhere, as if nothing had been added."""
        nothing = _frozen(np.zeros(len(self._texels.area)))
        self._received = _Received(nothing, nothing, nothing, 0.0)

    def __len__(self) -> int:
        """Number of texels."""
        return len(self._texels.area)

    @property
    def area(self) -> FloatArray:
        """(N,) area of each texel [m2], read-only."""
        return self._texels.area

    @property
    def corners(self) -> FloatArray:
        """(N, 3, 3) corners of each texel in the frame of the part [m], counter-clockwise from the side that is meant;
        read-only."""
        return self._texels.corners

    @property
    def normals(self) -> FloatArray:
        """(N, 3) unit normal of each texel in the frame of the part, read-only."""
        return self._texels.normals

    @property
    def dose(self) -> FloatArray:
        """(N,) float64 dose received so far [J/m2], read-only; 1 mJ/cm2 is 10 J/m2."""
        return self._received.dose

    @property
    def seconds_lit(self) -> FloatArray:
        """(N,) how long any light has reached each texel so far [s], read-only."""
        return self._received.seconds_lit

    @property
    def irradiance(self) -> FloatArray:
        """(N,) irradiance in the exposure added last [W/m2], NaN where unknown, read-only; 0 before the first."""
        return self._received.irradiance

    @property
    def seconds(self) -> float:
        """How long was exposed in all [s]."""
        return self._received.seconds

    @property
    def never_reached(self) -> npt.NDArray[np.bool_]:
        """(N,) whether a texel has had no dose at all so far."""
        never: npt.NDArray[np.bool_] = self._received.dose == 0.0
        return never

    def positions(self) -> FloatArray:
        """(N, 3) where texels are asked about, in the world as it is now [m].

        Raises:
            ValueError: the part is no longer in the scene, or has other vertices or triangles.
        """
        pose = self._mesh().pose
        return _moved(self._lifted, pose[:3, :3], pose[:3, 3])

    def pose(self) -> FloatArray:
        """(4, 4) pose of the part in the world as it is now.

        Raises:
            ValueError: as for :meth:`positions`.
        """
        return self._mesh().pose

    def attach(self, tracer: ShadowTracer) -> None:
        """Go on with a tracer whose scene holds the part, in whatever pose.

        Raises:
            ValueError: not a tracer, there is no such part, or its mesh is another surface; nothing has changed.
        """
        _check_tracer(tracer)
        if self.part not in tracer.scene:
            raise ValueError(f"part: expected one of {list(tracer.scene.names)}, got {self.part!r}, whose dose this is")
        mesh = tracer.scene[self.part]
        revisions = mesh.topology_revision, mesh.vertices_revision
        if tracer is self.tracer and revisions == self._known:
            return
        if not self._is_of(mesh):
            raise ValueError(
                f"part: {self.part!r} has other vertices or triangles than when its dose map was made; "
                "make a new map of it"
            )
        self.tracer, self._known = tracer, revisions

    def _is_of(self, mesh: Mesh) -> bool:
        return mesh_key(mesh.vertices, mesh.triangles) == self._key

    def irradiance_by(self, lights: Iterable[Light]) -> FloatArray:
        """(N,) irradiance of each texel by all of these lights together, as everything stands now [W/m2]; NaN where
        unknown. Adds nothing.

        Raises:
            ValueError: as for :meth:`add`.
            BoundsError: more lights than declared.
        """
        mesh = self._mesh()
        assert self.tracer is not None
        checked: Lights = check_lights(self.tracer.bounds, lights)
        check_strengths(checked)
        ordered = sorted(checked, key=lambda light: light.name)
        turn = mesh.pose[:3, :3]
        facing = _moved(self._texels.normals, turn, np.zeros(3))
        found = self.tracer.irradiance(
            _moved(self._lifted, turn, mesh.pose[:3, 3]), facing, ordered, 0.0, self._samples
        )
        total = np.zeros(len(self))
        for each in found:
            total += each
        return total

    def add(self, lights: Iterable[Light], seconds: float) -> None:
        """Expose the part to lights for a while, with everything where it is now.

        Args:
            lights: lights with a strength, with different names, of at most 64 points.
            seconds: how long, 0 or more [s].

        Raises:
            ValueError: an argument is malformed, a light has no strength, or the part has changed its vertices or
                triangles; nothing was added then.
            BoundsError: more lights than declared; nothing was added.
        """
        time = real(seconds)
        if not 0.0 <= time < np.inf:
            raise ValueError(f"seconds: expected a finite time of 0 or more, got {seconds!r}")
        found, old = self.irradiance_by(lights), self._received
        known = np.nan_to_num(found, nan=0.0)
        self._received = _Received(
            _frozen(old.dose + known * time),
            _frozen(old.seconds_lit + np.where(known > 0.0, time, 0.0)),
            _frozen(found),
            old.seconds + time,
        )

    def coverage(self, threshold: float) -> float:
        """Share of the area, 0 to 1, that has received at least ``threshold`` [J/m2].

        Raises:
            ValueError: the threshold is not a positive number.
        """
        reached = self.dose >= check_dose(threshold, "threshold")
        return float(self.area[reached].sum() / self.area.sum())

    def remaining(self, lights: Iterable[Light], threshold: float) -> FloatArray:
        """(N,) how long each texel still has to be exposed to these lights, with everything where it is now, until it
        has received ``threshold`` [J/m2]: seconds, 0 where it has, infinity where no light reaches, NaN where that is
        unknown.

        Raises:
            ValueError: as for :meth:`add`, or the threshold is not a positive number.
        """
        missing = check_dose(threshold, "threshold") - self.dose
        found = self.irradiance_by(lights)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # 0 / 0 where the target is reached
            return np.where(missing <= 0.0, 0.0, np.maximum(missing, 0.0) / found)

    def save(self, path: str | Path) -> None:
        """Write all of it to an NPZ file, bit for bit; :meth:`load` reads it. A file of that name stays as it was until
        the new one is whole.

        Raises:
            OSError: it cannot be written.
        """
        state = self._received
        write_npz(
            Path(path),
            {"part": self.part, "side": self.side, "mesh": self._key},
            {"max_edge": self.max_edge, "offset": self.offset, "seconds": state.seconds},
            {
                "corners": self.corners,
                "area": self.area,
                "normals": self.normals,
                "dose": state.dose,
                "seconds_lit": state.seconds_lit,
                "irradiance": state.irradiance,
            },
        )

    @classmethod
    def load(cls, path: str | Path, tracer: ShadowTracer | None = None, samples: str = "") -> DoseMap:
        """The map that :meth:`save` wrote.

        Args:
            path: the file.
            tracer: to go on with: its scene must hold the part as it was, in any pose. None: only what has been
                received can be asked.
            samples: as for the class.

        Raises:
            ValueError: not such a file (the field is named), or the part in the scene is another one.
        """
        texts, numbers, arrays = read_npz(Path(path))
        made = cls.__new__(cls)
        texels = Texels(arrays["corners"], arrays["area"], arrays["normals"])
        made._set_up(
            None, texts["part"], numbers["max_edge"], numbers["offset"], texts["side"], samples, texels, texts["mesh"]
        )
        dose, seconds_lit, irradiance = (_frozen(arrays[name]) for name in ("dose", "seconds_lit", "irradiance"))
        made._received = _Received(dose, seconds_lit, irradiance, numbers["seconds"])
        if tracer is not None:
            made.attach(tracer)
        return made

    @classmethod
    def merge(cls, maps: Sequence[DoseMap]) -> DoseMap:
        """What several maps of one surface have received together, as of robots that were there one after the other.

        Each sum is the float64 nearest to the exact one, so it does not depend on the order of the maps. There is no
        last exposure: ``irradiance`` is NaN. The tracer is that of the first map.

        Raises:
            ValueError: no map, or one of another surface, or cut into other texels; the message says which.
        """
        if not maps:
            raise ValueError("maps: expected at least one map, got none")
        first = maps[0]
        for place, each in enumerate(maps[1:], 1):
            for name in ("_key", "side", "max_edge", "offset"):
                if getattr(each, name) != getattr(first, name):
                    what = {"_key": "the mesh"}.get(name, name)
                    raise ValueError(f"maps: expected all of one surface, but {what} of number {place} is another")
        made, about = cls.__new__(cls), (first.part, first.max_edge, first.offset, first.side, first._samples)
        made._set_up(first.tracer, *about, first._texels, first._key)
        dose, lit = (_summed([getattr(each, name) for each in maps]) for name in ("dose", "seconds_lit"))
        seconds = math.fsum(each.seconds for each in maps)
        made._received = _Received(dose, lit, _frozen(np.full(len(first), np.nan)), seconds)
        return made

    def write_csv(self, path: str | Path) -> None:
        """Write a table: a head with units, then a row for each texel, with centre and normal in the frame of the
        part; numbers with all their digits."""
        write_csv(Path(path), self)

    def write_mesh(self, path: str | Path, target: float | None = None) -> None:
        """Write the texels as a mesh with a colour for each, in the frame of the part (extra ``dose``: trimesh).

        Colours are those of :meth:`picture`. A PLY file also bears ``dose`` [J/m2] and ``irradiance`` [W/m2] at each
        vertex.

        Args:
            path: ends with ``.ply`` or ``.glb``.
            target: dose that is wanted [J/m2], or None.

        Raises:
            ValueError: another ending, or the target is not a positive number.
            ImportError: trimesh is not installed; the message says how to install it.
        """
        write_mesh(Path(path), self, target)

    def picture(
        self,
        path: str | Path,
        target: float | None = None,
        camera: Camera | None = None,
        device: str | None = None,
    ) -> None:
        """Draw the part as a PNG with a legend (extra ``dose``: matplotlib): dose in the colours of viridis, what has
        the target in one flat colour, what was never reached in grey. Texels are seen from their own side alone, so one
        can look into a room from outside; other parts of the scene are pale.

        Args:
            path: the file.
            target: dose that is wanted [J/m2]; None: colours go up to the largest dose.
            camera: who looks; None: from above, askew, with all of the part in view.
            device: where it is drawn: "cpu", "cuda:0", ...; None is the tracer's, or the best there is.

        Raises:
            ValueError: the target is not a positive number.
            ImportError: matplotlib is not installed; the message says how to install it.
        """
        others: list[Mesh] = []
        pose = np.eye(4)
        if self.tracer is not None:
            pose = self._mesh().pose
            others = [mesh for mesh in self.tracer.scene if mesh.name != self.part]
            device = device or self.tracer.device
        draw(Path(path), self, target, camera, pose, others, device)

    def _mesh(self) -> Mesh:
        """The part, if it is still the same surface."""
        if self.tracer is None:
            raise ValueError("tracer: this map was loaded without one; DoseMap.load(path, tracer) goes on")
        self.attach(self.tracer)
        return self.tracer.scene[self.part]


def _check_tracer(tracer: object) -> None:
    if not isinstance(tracer, ShadowTracer):
        raise ValueError(f"tracer: expected a ShadowTracer, got {type(tracer).__name__}")


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array


def _moved(vectors: FloatArray, turn: FloatArray, shift: FloatArray) -> FloatArray:
    """(N, 3), each coordinate in the same order of operations as vertices on the device."""
    x, y, z = vectors.T
    return np.stack([((turn[k, 0] * x + turn[k, 1] * y) + turn[k, 2] * z) + shift[k] for k in range(3)], axis=-1)


def _summed(arrays: Sequence[FloatArray]) -> FloatArray:
    """Sums over arrays of one shape (N,), each rounded once."""
    rows = zip(*(array.tolist() for array in arrays), strict=True)
    return _frozen(np.array([math.fsum(row) for row in rows], np.float64))
