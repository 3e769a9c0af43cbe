# SPDX-License-Identifier: Apache-2.0
"""COLLADA: every kind of polygon, inputs and nodes as the format has them; what is not read is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mesh_figures import SQUARE, area, blocked, check, read

from shadow_tracer.ros.wire.parts import PartError

ONE = (2, (0, 0, 0), (1, 1, 0), 1.0)
NUMBERS = " ".join(f"{x:g}" for row in SQUARE for x in row)
TRIANGLES = '<triangles count="2"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 2 1 3</p></triangles>'
NODE = '<node id="n"><instance_geometry url="#g"/></node>'
DOOR = "0 0 0 1 0 0 1 0 2 2 0 2 2 0 0 4 0 0 4 0 3 0 0 3"


def source(numbers: str = NUMBERS, stride: int = 3, offset: int = 0, names: str = "XYZ", count: int = 0) -> str:
    """Positions; a blank among the names is a parameter without a name."""
    length = len(numbers.split())
    parameters = "".join(f'<param name="{name}" type="float"/>' if name != " " else "<param/>" for name in names)
    return (
        f'<source id="p"><float_array id="pa" count="{length}">{numbers}</float_array><technique_common><accessor '
        f'source="#pa" count="{count or length // stride}" stride="{stride}" offset="{offset}">{parameters}</accessor>'
        "</technique_common></source>"
    )


def geometry(primitives: str = TRIANGLES, positions: str = "", number: str = "") -> str:
    return (
        f'<geometry id="g{number}"><mesh>{positions or source()}'
        f'<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f"{primitives}</mesh></geometry>"
    )


def document(geometries: str = "", nodes: str = NODE, asset: str = "", more: str = "", scene: str = "#s") -> str:
    instance = f'<scene><instance_visual_scene url="{scene}"/></scene>' if scene else ""
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{asset}</asset><library_geometries>{geometries or geometry()}</library_geometries>{more}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        f"{instance}</COLLADA>"
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.dae"


def load(path: Path, text: str) -> tuple[tuple[np.ndarray, np.ndarray], str]:
    path.write_text(text)
    return read(path)


def refused(path: Path, text: str, reason: str) -> None:
    with pytest.raises(PartError, match=f"^mesh.files: .*a.dae.*{reason}"):
        load(path, text)


def primitive(kind: str, content: str, count: int = 1, inputs: str = "") -> str:
    return f'<{kind} count="{count}"><input semantic="VERTEX" source="#v" offset="0"/>{inputs}{content}</{kind}>'


@pytest.mark.parametrize(
    "primitives",
    [
        TRIANGLES,
        primitive("polylist", "<vcount>4</vcount><p>0 1 3 2</p>"),
        primitive("polylist", "<vcount>3 3</vcount><p>0 1 2 2 1 3</p>", 2),
        primitive("polygons", "<p>0 1 3 2</p>"),
        primitive("polygons", "<p>0 1 2</p><p>2 1 3</p>", 2),
        primitive("tristrips", "<p>0 1 2 3</p>"),
        primitive("tristrips", "<p>0 1 2</p><p>2 1 3</p>", 2),
        primitive("trifans", "<p>0 1 3 2</p>"),
        '<triangles count="0"/><polylist/>' + TRIANGLES + primitive("polylist", "<vcount/><p/>", 0),
        primitive("triangles", "<p>0 1 2</p>") + primitive("trifans", "<p>2 1 3</p>"),
        primitive("triangles", "<p>0 9 9 1 9 9 2 9 9 2 9 9 1 9 9 3 9 9</p>", 2,
                  '<input semantic="NORMAL" source="#x" offset="1"/>'
                  '<input semantic="TEXCOORD" source="#x" offset="2"/>'),
        primitive("triangles", "<p>9 0 9 1 9 2 9 2 9 1 9 3</p>", 2).replace('offset="0"', 'offset="1"').replace(
            "<p>", '<input semantic="NORMAL" source="#x" offset="0"/><p>'),
        primitive("triangles", "<p>0 1 2 <!-- 7 7 7 --> 2 1 3</p><!-- and --><extra><p>8 8 8</p></extra>", 2),
        "<!-- first -->" + TRIANGLES + "<!-- last --><?pi pi?>",
    ],
)  # fmt: skip
def test_polygons(path: Path, primitives: str) -> None:
    mesh, left_out = load(path, document(geometry(primitives)))
    check(mesh, *ONE)
    assert left_out == ""
    normals = np.cross(*(mesh[0][mesh[1][:, k]] - mesh[0][mesh[1][:, 0]] for k in (1, 2)))
    assert (normals[:, 2] > 0.0).all()


@pytest.mark.parametrize(
    "primitives",
    [
        primitive("polylist", "<vcount>8</vcount><p>0 1 2 3 4 5 6 7</p>"),
        primitive("polygons", "<p>0 1 2 3 4 5 6 7</p>"),
    ],
)
def test_concave_polygons(path: Path, primitives: str) -> None:
    mesh, _ = load(path, document(geometry(primitives, source(DOOR))))
    check(mesh, 6, (0, 0, 0), (4, 0, 3), 10)
    assert not blocked(mesh, (1.5, -1, 1), (1.5, 1, 1)) and blocked(mesh, (0.5, -1, 1), (0.5, 1, 1))


def test_polygons_with_holes(path: Path) -> None:
    numbers = "0 0 0 4 0 0 4 0 3 0 0 3 1 0 1 1 0 2 2 0 2 2 0 1 3 0 1 3 0 2 3.5 0 2"
    content = "<p>0 1 2</p><ph><p>0 1 2 3</p><h>4 5 6 7</h><h>8 9 10</h></ph>"
    mesh, _ = load(path, document(geometry(primitive("polygons", content, 2), source(numbers))))
    assert len(mesh[1]) == 1 + 13 and area(mesh) == pytest.approx(6 + 12 - 1 - 0.25)
    holed = (mesh[0], mesh[1][1:])
    assert not blocked(holed, (1.5, -1, 1.5), (1.5, 1, 1.5)) and blocked(holed, (2.4, -1, 1.37), (2.4, 1, 1.37))


def test_what_has_no_triangles_is_said(path: Path) -> None:
    primitives = TRIANGLES + primitive("lines", "<p>0 1</p>") + primitive("linestrips", "<p>0 1 2</p>")
    primitives += primitive("polylist", "<vcount>2 1</vcount><p>0 1 2</p>", 2)
    more = "<library_animations><animation/></library_animations>"
    mesh, left_out = load(path, document(geometry(primitives), more=more))
    check(mesh, *ONE)
    assert left_out == "lines (2), polygons with fewer than 3 corners (2), animations (1)"
    refused(path, document(geometry(primitive("lines", "<p>0 1</p>"))), r"has no triangles, only lines \(1\)$")


@pytest.mark.parametrize(
    "positions",
    [
        source("9 9 " + NUMBERS, offset=2, count=4),
        source(" ".join(f"7 {z:g} {x:g} {y:g} 8" for x, y, z in SQUARE), 5, names=" ZXY "),
        source(NUMBERS, names=""),
        source(" ".join(f"{x:g} {y:g} {z:g} 1" for x, y, z in SQUARE), 4, names="XYZW"),
        source(NUMBERS.replace(" ", "\n\t")),
    ],
)
def test_positions(path: Path, positions: str) -> None:
    check(load(path, document(geometry(positions=positions)))[0], *ONE)


def test_units_are_applied_and_the_up_axis_is_not(path: Path) -> None:
    for axis in ("X_UP", "Y_UP", "Z_UP"):
        asset = f'<unit name="centimeter" meter="0.01"/><up_axis>{axis}</up_axis>'
        text = document(asset=asset, nodes=NODE.replace("<inst", "<translate>0 0 50</translate><inst"))
        check(load(path, text)[0], 2, (0, 0, 0.5), (0.01, 0.01, 0.5), 1e-4)
        check(read(path, 2.0)[0], 2, (0, 0, 100), (2, 2, 100), 4)
    refused(path, document(asset='<unit meter="0"/>'), "asset/unit: expected metres per unit, got '0'")
    refused(path, document(asset='<unit meter="x"/>'), "asset/unit: expected numbers")


@pytest.mark.parametrize(
    ("transforms", "low", "high"),
    [
        ("<translate>1 2 3</translate>", (1, 2, 3), (2, 3, 3)),
        ("<translate>1 0 0</translate><scale>2 3 1</scale>", (1, 0, 0), (3, 3, 0)),
        ("<scale>2 3 1</scale><translate>1 0 0</translate>", (2, 0, 0), (4, 3, 0)),
        ("<rotate>0 0 2 90</rotate>", (-1, 0, 0), (0, 1, 0)),
        ("<rotate>0 0 1 90</rotate><translate>5 0 0</translate>", (-1, 5, 0), (0, 6, 0)),
        ("<rotate>1 0 0 90</rotate><rotate>0 0 1 90</rotate>", (-1, 0, 0), (0, 0, 1)),
        ("<rotate>0 0 0 0</rotate>", (0, 0, 0), (1, 1, 0)),
        ("<matrix>0 -1 0 7 1 0 0 8 0 0 1 9 0 0 0 1</matrix>", (6, 8, 9), (7, 9, 9)),
        ("<scale>-1 1 1</scale>", (-1, 0, 0), (0, 1, 0)),
    ],
)
def test_transforms_in_their_order(path: Path, transforms: str, low: object, high: object) -> None:
    mesh, _ = load(path, document(nodes=NODE.replace("<instance", f"{transforms}<instance")))
    corners = mesh[0][mesh[1]].reshape(-1, 3)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [low, high], rtol=0, atol=1e-12)
    if transforms.startswith("<scale>-1"):
        normals = np.cross(*(mesh[0][mesh[1][:, k]] - mesh[0][mesh[1][:, 0]] for k in (1, 2)))
        assert (normals[:, 2] > 0.0).all()


def test_nodes_within_nodes_and_instances_of_nodes(path: Path) -> None:
    library = (
        '<library_nodes><node id="leaf"><translate>0 0 1</translate><instance_geometry url="#g"/></node>'
        '<node id="two"><instance_node url="#leaf"/><node id="inner"><translate>10 0 0</translate>'
        '<instance_node url="#leaf"/></node></node></library_nodes>'
    )
    two = '<node><instance_node url="#two"/></node>'
    nodes = f"{two}<node><scale>2 1 1</scale>{two}</node>"
    mesh, _ = load(path, document(nodes=nodes, more=library))
    check(mesh, 8, (0, 0, 1), (22, 1, 1), 6)


def test_only_the_scene_is_read(path: Path) -> None:
    geometries = geometry() + geometry(positions=source(NUMBERS.replace("1", "5")), number="2")
    check(load(path, document(geometries))[0], *ONE)
    check(load(path, document(geometries, scene=""))[0], *ONE)  # there is but one
    refused(path, document(geometries, nodes='<node id="n"/>'), "no node of its scene places them")


CONTROLLER = '<node id="n"><instance_controller url="#c"/></node>'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (document(nodes=CONTROLLER), "node 'n' uses the controller '#c': skins and morphs are not read; apply them"),
        (document(nodes=NODE + CONTROLLER), "skins and morphs are not read"),
        (document(nodes=NODE.replace("#g", "#h")), "has 0 times the geometry '#h'"),
        (document(geometry() + geometry()), "has 2 times the geometry '#g'"),
        (document(nodes=NODE.replace("#g", "b.dae#g")), "geometry 'b.dae#g'; only what is in the same file is read"),
        (document(nodes='<node id="n"><instance_node url="#n"/></node>'), "node 'n' is found within itself"),
        (document(nodes=NODE.replace("<inst", "<skew>45 0 1 0 1 0 0</skew><inst")), "uses 'skew', which is not read"),
        (document(nodes=NODE.replace("<inst", "<scale>1 1</scale><inst")), "scale: expected 3 numbers, got 2"),
        (document(nodes=NODE.replace("<inst", "<rotate>0 0 0 9</rotate><inst")), "rotate: expected an axis"),
        (document(nodes=NODE.replace("<inst", f"<matrix>{'1 ' * 16}</matrix><inst")), "expected the last row 0 0 0 1"),
        (document(scene="#t"), "has 0 times the visual_scene '#t'"),
        (document(geometry(TRIANGLES.replace("1 3", "-1 3"))), "vertex indices from -1 to 3"),
        (document(geometry(TRIANGLES.replace("1 3", "1 4"))), "vertex indices from 0 to 4, counted from 0, but 4"),
        (document(geometry(TRIANGLES.replace("1 3", "1"))), "5 corners do not make 2 of them"),
        (document(geometry(TRIANGLES.replace("1 3", "1 x"))), "expected numbers"),
        (document(geometry(TRIANGLES.replace('count="2"', 'count="3"'))), "6 corners do not make 3 of them"),
        (document(geometry(TRIANGLES.replace("VERTEX", "POSITION"))), "expected one input VERTEX, got 0"),
        (document(geometry(primitive("polylist", "<vcount>3</vcount><p>0 1 2 3</p>"))), "4 corners do not make 1"),
        (
            document(geometry(primitive("polylist", "<vcount>5 -1</vcount><p>0 1 2 3</p>", 2))),
            "4 corners do not make 2",
        ),
        (document(geometry(primitive("polygons", "<p>0 1 2</p>", 2))), "3 corners do not make 2"),
        (document(geometry(primitive("triangles", "", 2))), "0 corners do not make 2"),
        (document(geometry(primitive("tristrips", "<p>0 1</p>"))), "2 corners do not make 1"),
        (document(geometry(primitive("polygons", "<ph><p>0 1 3 2</p><h>0 1</h></ph>"))), "fewer than 3 corners"),
        (document(geometry(positions=source(count=5))), "5 positions with stride 3 do not fit into 12 numbers"),
        (document(geometry(positions=source(stride=2, names="XY"))), "with stride 2 do not fit"),
        (document(geometry(positions=source().replace('count="12"', 'count="15"'))), "says 15 numbers and has 12"),
        (document(geometry(positions=source().replace("#pa", "#pb"))), "expected one float_array 'pb'"),
        (document(geometry(positions=source().replace('id="p"', 'id="q"'))), "has no source 'p'"),
        (
            document('<geometry id="g"><convex_mesh convex_hull_of="#h"/></geometry>'),
            "is convex_mesh, which is not read",
        ),
        (document()[:-20], "it is no XML"),
        ("<kml/>", "it is no COLLADA: its root is 'kml'"),
    ],
)
def test_what_is_refused(path: Path, text: str, reason: str) -> None:
    refused(path, text, reason)


def test_a_camera_that_looks_at_something_matters_not(path: Path) -> None:
    camera = '<node id="c"><lookat>0 0 1 0 0 0 0 1 0</lookat><instance_camera url="#x"/></node>'
    check(load(path, document(nodes=camera + NODE))[0], *ONE)


def test_instances_of_instances_end(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each node twice in the next: no file may take all memory."""
    monkeypatch.setattr("shadow_tracer.ros.wire.mesh_files.collada._MOST_NODES", 1000)
    nodes = "".join(
        f'<node id="k{k}"><instance_node url="#k{k - 1}"/><instance_node url="#k{k - 1}"/></node>' for k in range(1, 40)
    )
    more = f'<library_nodes><node id="k0"><instance_geometry url="#g"/></node>{nodes}</library_nodes>'
    refused(path, document(nodes='<node><instance_node url="#k39"/></node>', more=more), "instances are too many")
