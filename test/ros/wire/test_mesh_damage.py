# SPDX-License-Identifier: Apache-2.0
"""A square by every format, damaged in any place: it is read as a mesh that a scene takes, or refused with its name."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from mesh_figures import SQUARE, TWO, Gltf, check, read

from shadow_tracer import Scene
from shadow_tracer.ros.wire.parts import PartError

ROWS = "".join("{} {} {}\n".format(*row) for row in SQUARE)
PLY = (
    "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
    "property list uchar int vertex_indices\nend_header\n"
)
FACET = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"
DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit meter="1"/></asset><library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="12">
0 0 0 1 0 0 0 1 0 1 1 0</float_array><technique_common><accessor source="#pa" count="4" stride="3"/></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices><polylist count="2"><input
semantic="VERTEX" source="#v" offset="0"/><vcount>3 3</vcount><p>0 1 2 2 1 3</p></polylist></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
</matrix><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes><scene><instance_visual_scene
url="#s"/></scene></COLLADA>"""
RELATIONS = """<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r"
Target="/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"""
MODEL = """<model unit="meter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object
id="1"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/><vertex x="1"
y="1" z="0"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/><triangle v1="2" v2="1" v3="3"/></triangles></mesh>
</object></resources><build><item objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0 0"/></build></model>"""


def archive(model: bytes) -> bytes:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as file:
        file.writestr("_rels/.rels", RELATIONS)
        file.writestr("3D/3dmodel.model", model)
    return memory.getvalue()


def gltf() -> Gltf:
    made = Gltf()
    made.mesh(made.square())
    return made


def stl() -> tuple[bytes, bytes]:
    corners = np.array(SQUARE, "<f4")[np.array(TWO)]
    text = "".join(FACET.format("".join("vertex {} {} {}\n".format(*row) for row in three)) for three in corners)
    packed = b"".join(bytes(12) + three.tobytes() + bytes(2) for three in corners)
    return f"solid a\n{text}endsolid a\n".encode(), bytes(80) + struct.pack("<I", 2) + packed


FILES = {
    "a.obj": ("".join(f"v {row}\n" for row in ROWS.splitlines()) + "f 1//1 2//1 3//1\nf -2 -3 -1 # last\n").encode(),
    "a.off": f"OFF\n4 2 0\n{ROWS}3 0 1 2\n3 2 1 3\n".encode(),
    "text.ply": (PLY.format("ascii") + ROWS + "3 0 1 2\n3 2 1 3\n").encode(),
    "binary.ply": PLY.format("binary_little_endian").encode()
    + np.array(SQUARE, "<f4").tobytes()
    + struct.pack("<B3iB3i", 3, *TWO[0], 3, *TWO[1]),
    "text.stl": stl()[0],
    "binary.stl": stl()[1],
    "a.glb": gltf().bytes(),
    "a.dae": DAE.encode(),
    "a.3mf": archive(MODEL.encode()),
    "model.3mf": MODEL.encode(),  # damaged before it is packed, as an archive has checksums
}


@pytest.mark.parametrize("name", FILES)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(20261128)
    path, refused = tmp_path / name, 0
    pack = archive if name == "model.3mf" else bytes
    path.write_bytes(pack(FILES[name]))
    check(read(path)[0], 2, (0, 0, 0), (1, 1, 0), 1.0)
    for _ in range(150):
        data = bytearray(FILES[name])
        for _ in range(rng.integers(1, 4)):
            at = rng.integers(0, len(data))
            new = [rng.bytes(rng.integers(0, 4)), b"-1", b"99", b" ", b"nan", b"\n"][rng.integers(6)]
            data[at : at + rng.integers(0, 4)] = new
        path.write_bytes(pack(bytes(data)))
        try:
            mesh, _ = read(path)
        except PartError as error:
            refused += 1
            assert str(error).startswith("mesh.files: ") and name in str(error)
        else:
            Scene().put("mesh", *mesh)
    assert refused > 30


@pytest.mark.parametrize("name", [name for name in FILES if name != "a.obj"])  # OBJ has no counts and no end
def test_files_that_are_cut_short(tmp_path: Path, name: str) -> None:
    """No beginning of a file passes for another mesh: it is refused, or only what says nothing was lost."""
    path = tmp_path / name
    pack = archive if name == "model.3mf" else bytes
    path.write_bytes(pack(FILES[name]))
    whole = read(path)[0]
    for length in range(0, len(FILES[name]), 3):
        path.write_bytes(pack(FILES[name][:length]))
        try:
            found = read(path)[0]
        except PartError:
            continue
        for one, other in zip(found, whole, strict=True):
            np.testing.assert_array_equal(one, other)
