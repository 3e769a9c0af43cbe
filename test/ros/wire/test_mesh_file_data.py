# SPDX-License-Identifier: Apache-2.0
"""Real mesh files and hard hand-made ones: what is read is what they hold, or they are refused with the reason.

The files are data that is not in this repository (see ``data``); without them these tests are skipped by name. The
figures were found without any reader of this package.
"""

from __future__ import annotations

import data
import numpy as np
import pytest
from mesh_figures import blocked, check, read

from shadow_tracer.ros.wire.parts import PartError

# Triangles, lower and upper corner of the bounding box [m], area [m2].
GOOD = {
    "featuretype.3MF": (2208, (-0.0635, -0.03175, 0), (0.0635, 0.03175, 0.03492), 0.0347196),
    "pyramids.3mf": (3276, (0.005012, 0.005024, 0.01002), (0.3517, 0.1681, 0.03503), 0.0439105),
    "anymal_battery.dae": (12, (-0.2259, -0.0625, -0.07014), (0.2322, 0.0625, 0.00396), 0.200935),
    "aws_elevator_door.dae": (376, (-0.7083, 0.03902, -0.0002128), (0.7083, 0.1241, 2.27), 6.94227),
    "aws_ramp.dae": (4, (-1.215, -1.227, -0.0003322), (1.214, 1.227, 0.1755), 6.40839),
    "aws_tv.DAE": (12, (0.00848, -0.6986, 0.001839), (0.06888, 0.6304, 0.7983), 2.37379),
    "gz_box_with_hierarchical_nodes.dae": (84, (-1, -3.546, 0), (1, -1.546, 2), 168),
    "gz_cordless_drill.dae": (1126, (-0.1437, -0.1058, 0.092), (0.03774, 0.1262, 0.3466), 0.11023),
    "spot_pack_body.dae": (44, (-0.3349, -0.1077, -0.01325), (0.3649, 0.1081, 0.08437), 0.388325),
    "teapot_instancenodes.DAE": (2048, (-4.824, -1.04, 0), (1.799, 1.237, 1.742), 31.5197),
    "ur3_wrist3.dae": (528, (-0.03179, 0.04065, -0.03382), (0.03167, 0.08048, 0.03581), 0.019102),
    "gz_box.glb": (12, (-1, -1, -1), (1, 1, 1), 24),
    "nested.glb": (36, (-1.167, -2.337, -0.2694), (0.2694, 1, 0.2694), 8.6772),
    "no_indices_3storybuilding.glb": (72, (-23.21, 0, 0), (32.87, 9, 63.36), 12527.7),
    "simple_pole.glb": (580, (-0.5, 0, -6), (0.5, 20.5, 6), 228.019),
    "face_in_group_name_mid_file.obj": (2, (1, 5, 10), (15, 20, 30), 113.318),
    "gz_box.obj": (12, (-1, -1, -1), (1, 1, 1), 24),
    "negative_indices.obj": (12, (-1, -1, -1), (1, 1, 1), 24),
    "two_objects.obj": (16, (0, 0, 0), (1, 1, 1), 8.36603),
    "wallhole.obj": (66, (0, 0, -10), (10, 15, 0), 721.421),
    "comments.off": (12, (-1.633, -1.633, -1.155), (1.633, 1.633, 1.155), 32),
    "whitespace.off": (12, (-1.633, -1.633, -1.155), (1.633, 1.633, 1.155), 32),
    "cube_blender_uv.ply": (12, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), 6),
    "mirror_big_endian.ply": (286, (-0.7262, 5.221, 7.691), (0.3918, 6.339, 7.809), 1.62702),
    "multi.ply": (2, (-1, -1, 0), (1, 1, 0), 4),
    "octagonal_pocket.ply": (3262, (0, 0, 0), (0.2286, 0.1647, 0.01588), 0.0748225),
    "tet.ply": (4, (-1, -1, -1), (1, 1, 1), 8.94427),
    "franka_link0.stl": (200, (-0.1541, -0.09461, -3.249e-05), (0.07157, 0.09467, 0.14), 0.120426),
    "gz_cube.stl": (12, (0, -20, 0), (20, 0, 20), 2400),
    "multibody.stl": (32, (-0.5108, -0.7188, -0.05193), (0.1252, 0.3696, 0.288), 0.367239),
    "spot_arm_link2.stl": (36, (-36, -30, 80), (39, 356, 150), 110612),
    "two_objects_mixed_case_names.stl": (24, (0, 0, 0), (6, 1, 1), 12),
    "unit_cube.STL": (12, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), 6),
    "ur10_base.stl": (366, (-0.07497, -0.092, 0), (0.07499, 0.0751, 0.038), 0.0615207),
}

SQUARE = (2, (0, 0, 0), (1, 1, 0), 1)
TWO_SQUARES = (4, (0, 0, 0), (1, 1, 2), 2)
CUBE = (12, (0, 0, 0), (1, 1, 1), 6)
DOORWAY = (6, (0, 0, 0), (4, 0, 3), 10)
ARROW = (2, (0, 0, 0), (2, 0, 2), 1.5)
PRISM = (8, (0, 0, 0), (1, 1, 2), 5 + 2 * np.sqrt(2))

HARD = {
    "comments_in_mesh.dae": SQUARE,
    "comments_in_numbers.dae": SQUARE,
    "concave_quad.obj": ARROW,
    "concave_quad.ply": ARROW,
    "doorway.dae": DOORWAY,
    "doorway.obj": DOORWAY,
    "doorway.ply": DOORWAY,
    "doorway_binary.ply": DOORWAY,
    "doorway_polygons_centimetres.dae": DOORWAY,
    "draco_required.glb": SQUARE,
    "fan_beside_triangles.glb": TWO_SQUARES,
    "gpu_instancing_required.glb": (6, (0, 0, 0), (1, 1, 2), 3),
    "instance_node_nested.dae": (8, (-3, 0, 1), (22, 22, 6), 14),
    "mixed_faces_binary.ply": PRISM,
    "mixed_faces_extra_properties_binary.ply": PRISM,
    "morph_weight_one.glb": (2, (0, 0, 2), (1, 1, 2), 1),
    "nan_unused.obj": SQUARE,
    "nan_unused_binary.ply": SQUARE,
    "percent20.gltf": SQUARE,
    "quantized_int16_normalized.glb": (2, (0, 0, 0), (4, 4, 0), 16),
    "relative_blocks.obj": (4, (0, 0, 0), (5, 2, 2), 5),
    "sparse_accessor.glb": SQUARE,
    "sparse_over_view.glb": (2, (0, 0, 0), (3, 3, 0), 3),
    "tabs_and_comments.obj": SQUARE,
    "tristrips.ply": TWO_SQUARES,
    "tristrips_binary.ply": TWO_SQUARES,
    "two_extra_bytes.stl": CUBE,
    "window_polygon_with_hole.dae": (8, (0, 0, 0), (4, 0, 3), 10),
    "zero_area_beside_good.obj": (3, (0, 0, 0), (2, 1, 0), 1),
}

REFUSED = {
    "count_zero.stl": "has no triangles",
    "count_zero_with_triangles.stl": "it has 0 triangles, but 12 fit into its bytes",
    "cut_short.stl": "cut short: it should have 12 triangles and has 7",
    "cut_short_whole_triangles.stl": "cut short: it should have 12 triangles and has 7",
    "nan_used.obj": r"vertex 2 of .* is \[0.0, nan, 0.0\] m",
    "negative_index.dae": "vertex indices from -3 to 3, counted from 0, but 4 vertices",
    "square buffer.bin": "not supported",
    "zero_area.obj": r"every triangle of .* has zero area \(2 of them\)",
}

# Segments that must get through, and some that must not.
FREE = {
    "concave_quad": [((0.2, -1, 1), (0.2, 1, 1))],
    "doorway": [((1.5, -1, 1), (1.5, 1, 1))],
    "window": [((2, -1, 1.5), (2, 1, 1.5))],
}
BLOCKED = {
    "concave_quad": [((1, -1, 1.1), (1, 1, 1.1))],
    "doorway": [((0.5, -1, 1), (0.5, 1, 1)), ((1.5, -1, 2.5), (1.5, 1, 2.5))],
    "window": [((0.5, -1, 1.5), (0.5, 1, 1.5))],
}


@pytest.mark.parametrize("name", GOOD)
def test_real_files(name: str) -> None:
    check(read(data.file(f"files/good/{name}"))[0], *GOOD[name])


@pytest.mark.parametrize("name", HARD)
def test_hard_files(name: str) -> None:
    if "draco" in name:
        pytest.importorskip("DracoPy", reason="needs DracoPy: pip install DracoPy")
    mesh, left_out = read(data.file(f"files/hard/{name}"))
    check(mesh, *HARD[name])
    assert left_out == ("2 bytes at the end" if name == "two_extra_bytes.stl" else "")
    for kind, segments in FREE.items():
        if name.startswith(kind):
            assert not any(blocked(mesh, *segment) for segment in segments)
            assert all(blocked(mesh, *segment) for segment in BLOCKED[kind])


@pytest.mark.parametrize("name", REFUSED)
def test_files_that_cannot_be_right(name: str) -> None:
    path = data.file(f"files/hard/{name}")
    if path.suffix == ".bin":
        pytest.importorskip("trimesh", reason="needs trimesh: pip install 'shadow_tracer[mesh]'")
    with pytest.raises(PartError, match=f"^mesh.files: .*{REFUSED[name]}"):
        read(path)


def test_no_file_is_forgotten() -> None:
    names = {path.name for path in data.file("files/hard").iterdir()}
    assert names == HARD.keys() | REFUSED.keys()
    assert {path.name for path in data.file("files/good").iterdir()} == GOOD.keys()
