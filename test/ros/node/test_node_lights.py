# SPDX-License-Identifier: Apache-2.0
"""Lights that topics move, that come and go, the sun, and what is published of each: equal bits with the library."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import lamps
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import FOCAL, HEIGHT, WIDTH, Rig, nanoseconds, plate, wall
from node_world import BIAS, UNKNOWN, all_unknown, camera, library, library_with_plate, pose_msg, shadow_size
from sensor_msgs.msg import CameraInfo, Image
from tf_double import Buffer, module, transform

from shadow_tracer import (
    DirectionalLight,
    DiscLight,
    Frame,
    IntensityTable,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
    Strength,
    SunDisc,
    TubeLight,
)
from shadow_tracer.ros.cameras.overlay import overlay
from shadow_tracer.ros.diagnostics import ERROR, OK, PROCESSING, TRANSFORMS, WARN
from shadow_tracer.ros.parameters.parameters import default_of
from shadow_tracer.ros.wire.messages import rigid

HALF = math.sqrt(0.5)
ALONG_Z = (0.0, -HALF, 0.0, HALF)  # a rotation that turns +x to +z
THREE = {
    "mask.unknown_value": UNKNOWN,
    "light_names": ["lamp", "spot", "sky"],
    "lights.spot.type": "spot",
    "lights.spot.outer_angle": 0.4,
    "lights.sky.type": "directional",
}


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig(THREE) as made:
        made.send_mesh(*plate())
        yield made


@pytest.fixture(scope="module")
def tracer() -> ShadowTracer:
    return library_with_plate()


def expected(tracer: ShadowTracer, *lights: Any) -> Frame:
    return tracer.trace(wall(), camera(), lights, bias=BIAS)


def place(rig: Rig, name: str, *pose: Any, **more: Any) -> None:
    """Send a light a pose, and wait until it has it."""
    lighting = rig.core.inputs.lighting
    before = lighting._poses.get(name)
    rig.publisher(PoseStamped, f"shadow_tracer/lights/{name}/pose").publish(pose_msg(*pose, **more))
    rig.until(lambda: lighting._poses.get(name) is not before, what=f"{name} is placed")


def check(rig: Rig, frame: Frame) -> None:
    """The next masks are those of the library: of every light, and of all together."""
    for name in frame.names:
        if name not in rig.masks:
            rig.listen_to_light(name)
    stamp = rig.send_frame(wall())
    np.testing.assert_array_equal(rig.mask_of(stamp), frame.mask(unknown=UNKNOWN))
    for name in frame.names:
        np.testing.assert_array_equal(rig.mask_of(stamp, name), frame.mask(name, unknown=UNKNOWN))


def test_topics_move_lights_which_shine_along_x(rig: Rig, tracer: ShadowTracer) -> None:
    turned = rigid((0.0, 0.0, 0.0), ALONG_Z, "pose")
    tilted = rigid((0.0, 0.0, 0.0), (0.1, -0.7, 0.0, HALF), "pose")
    place(rig, "lamp", (0.4, -0.3, 0.1))
    place(rig, "spot", (-0.3, 0.1, 0.0), ALONG_Z, frame="camera")
    place(rig, "sky", (9.0, 9.0, 9.0), (0.1, -0.7, 0.0, HALF))
    spot = SpotLight("spot", (-0.3, 0.1, 0.0), turned[:3, 0], 0.4)
    np.testing.assert_allclose(turned[:3, 0], (0, 0, 1), atol=1e-15)
    sky = DirectionalLight("sky", tilted[:3, 0])
    check(rig, expected(tracer, PointLight("lamp", (0.4, -0.3, 0.1)), spot, sky))
    rig.until(lambda: rig.value(TRANSFORMS, "lights placed by topics") == "lamp, spot, sky")
    place(rig, "lamp", (-0.4, -0.3, 0.1))
    check(rig, expected(tracer, PointLight("lamp", (-0.4, -0.3, 0.1)), spot, sky))


def test_the_last_wish_counts(rig: Rig, tracer: ShadowTracer) -> None:
    """Parameters take over from topics light by light, and only where they say something about the place."""
    place(rig, "lamp", (0.4, -0.3, 0.1))
    place(rig, "spot", (-0.3, 0.1, 0.0), ALONG_Z)
    way = rigid((0.0, 0.0, 0.0), ALONG_Z, "pose")[:3, 0]
    sky = DirectionalLight("sky", (0.0, 0.0, 1.0))
    assert rig.set(lights__lamp__range=2.2, lights__spot__outer_angle=0.3) == ""
    spot = SpotLight("spot", (-0.3, 0.1, 0.0), way, 0.3)
    check(rig, expected(tracer, PointLight("lamp", (0.4, -0.3, 0.1), range=2.2), spot, sky))
    assert rig.set(lights__lamp__position=[0.1, -0.6, 0.0]) == ""
    check(rig, expected(tracer, PointLight("lamp", (0.1, -0.6, 0.0), range=2.2), spot, sky))
    place(rig, "lamp", (0.2, 0.6, 0.0))
    check(rig, expected(tracer, PointLight("lamp", (0.2, 0.6, 0.0), range=2.2), spot, sky))


def test_a_bad_pose_is_refused_and_the_last_one_stays(rig: Rig, tracer: ShadowTracer) -> None:
    place(rig, "lamp", (0.4, -0.3, 0.1))
    before = rig.trace(wall())
    publisher = rig.publisher(PoseStamped, "shadow_tracer/lights/lamp/pose")
    bad = (((0, 0, 0), (0, 0, 0, 0)), ((0, math.nan, 0), (0, 0, 0, 1)), ((0, 0, 0), (1, 1, 1, 1)))
    for number, (position, rotation) in enumerate(bad, 1):
        publisher.publish(pose_msg(position, rotation))
        rig.until(lambda number=str(number): rig.value(TRANSFORMS, "refused poses") == number)
        rig.wait_status(TRANSFORMS, ERROR, "pose refused, lights/lamp/pose: pose: expected")
    np.testing.assert_array_equal(rig.trace(wall()), before)


def test_a_light_follows_the_frame_of_its_pose(monkeypatch: pytest.MonkeyPatch, tracer: ShadowTracer) -> None:
    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    parameters = {"mask.unknown_value": UNKNOWN, "fixed_frame": "map", "lights.lamp.frame": "camera", "tf_timeout": 0.0}
    with Rig(parameters) as rig:
        buffer: Buffer = made[0]
        for name in ("camera", "odom"):
            buffer.set_transform_static(transform("map", name, 0), "test")
        for stamp, x in ((rig.stamp, 0.2), (rig.stamp + 2_000_000_000, 0.2 + 2.0)):
            buffer.set_transform(transform("odom", "tool", stamp, (x, 0.0, 0.0)), "test")
        rig.send_mesh(*plate())
        for frame, x in (("tool", 0.2 + 0.033), ("odom", 0.0), ("", 0.0)):
            place(rig, "lamp", (0.1, -0.3, 0.0), frame=frame)
            lamp = PointLight("lamp", (0.1 + x, -0.3, 0.0))
            np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, lamp).mask(unknown=UNKNOWN))
        place(rig, "lamp", (0.1, -0.3, 0.0), frame="nowhere")
        assert all_unknown(rig.trace(wall()))
        rig.wait_status(TRANSFORMS, WARN, "'nowhere' to 'map' for header.frame_id of lights/lamp/pose")


def test_lights_come_go_and_are_switched_live(rig: Rig, tracer: ShadowTracer) -> None:
    lamp, sky = PointLight("lamp", (0.5, -0.5, 0.0)), DirectionalLight("sky", (0.0, 0.0, 1.0))
    spot = SpotLight("spot", (0.5, -0.5, 0.0), (0.0, 0.0, 1.0), 0.4)
    check(rig, expected(tracer, lamp, spot, sky))
    assert rig.set(lights__lamp__enabled=False) == ""
    count = len(rig.masks["lamp"])
    frame = expected(tracer, spot, sky)
    check(rig, frame)
    assert len(rig.masks["lamp"]) == count  # of a light that does not shine nothing is published
    assert rig.set(light_names=["lamp", "spot", "sky", "fill"], lights__lamp__enabled=True) == ""
    assert rig.set(lights__fill__position=[-0.5, 0.2, 0.1]) == ""
    fill = PointLight("fill", (-0.5, 0.2, 0.1))
    check(rig, expected(tracer, lamp, spot, sky, fill))
    place(rig, "fill", (-0.1, 0.2, 0.1))
    check(rig, expected(tracer, lamp, spot, sky, PointLight("fill", (-0.1, 0.2, 0.1))))
    assert rig.set(light_names=["sky"]) == ""
    np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, sky).mask(unknown=UNKNOWN))
    topics = ("/shadow_tracer/mask/fill", "/shadow_tracer/mask/lamp")
    rig.until(lambda: not any(rig.friend.count_publishers(topic) for topic in topics), what="their topics go")
    rig.until(lambda: rig.friend.count_subscribers("/shadow_tracer/lights/fill/pose") == 0)
    assert rig.set(light_names=["sky", "fill"]) == ""  # as new: the topic's pose went with the light
    rig.masks.pop("fill")
    check(rig, expected(tracer, sky, PointLight("fill", (0.5, -0.5, 0.0))))


NOON = "2026-06-21T12:00:00Z"
PLACE = {"lights.lamp.type": "sun", "lights.lamp.sun.latitude": 48.0, "lights.lamp.sun.longitude": 11.5}
# East, north, up as seen by the camera (right, down, forward) of these tests: it looks down, right is east.
EAST_NORTH_UP = {"pose_source": "parameter", "fixed_frame": "map", "camera_pose": [0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0]}


def ns(text: str) -> int:
    when = datetime.fromisoformat(text.replace("Z", "+00:00"))
    return int((when - datetime(1970, 1, 1, tzinfo=timezone.utc)).total_seconds()) * 1_000_000_000


def below(height: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """A level plate in the map, at a height."""
    vertices, triangles = plate(distance=height)
    return vertices, triangles


def test_the_sun_at_a_given_time_and_at_the_stamp_of_the_image() -> None:
    ephem = pytest.importorskip("ephem")
    tracer = library()
    tracer.scene.put("mesh", *below())
    pose = rigid((0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 0.0), "camera_pose")

    def mask(text: str) -> np.ndarray:
        """The sun of the library behind the node, asked directly."""
        observer = ephem.Observer()
        observer.lat, observer.lon = "48", "11.5"
        observer.elevation, observer.pressure, observer.temp = 0.0, 1010.0, 15.0
        observer.date = ephem.Date(text.replace("T", " ").rstrip("Z").replace("-", "/"))
        seen = ephem.Sun(observer)
        level = math.cos(seen.alt)
        way = (-level * math.sin(seen.az), -level * math.cos(seen.az), -math.sin(seen.alt))
        return tracer.trace(wall(), camera(pose), [DirectionalLight("lamp", way)], bias=BIAS).mask(unknown=UNKNOWN)

    parameters = {"mask.unknown_value": UNKNOWN, **EAST_NORTH_UP, **PLACE, "lights.lamp.sun.time": NOON}
    with Rig(parameters) as rig:
        rig.send_mesh(*below())
        noon = rig.trace(wall())
        np.testing.assert_array_equal(noon, mask(NOON))
        # At noon the shadow lies north of the plate: up in the image of a camera that looks down.
        rows = np.flatnonzero((noon == 0).any(axis=1))
        assert len(rows) and rows.mean() < (HEIGHT - 1) / 2
        assert rig.set(lights__lamp__sun__time="") == ""
        for text in ("2026-06-21T08:00:00Z", "2026-06-21T10:30:00Z", NOON):
            np.testing.assert_array_equal(rig.trace(wall(), stamp=ns(text)), mask(text))
        morning = rig.trace(wall(), stamp=ns("2026-06-22T08:00:00Z"))
        assert np.flatnonzero((morning == 0).any(axis=0)).mean() < (WIDTH - 1) / 2  # the sun in the east, shadow west
        assert not np.array_equal(morning, noon)
        assert rig.set(lights__lamp__sun__latitude=-48.0) == ""
        south = rig.trace(wall(), stamp=ns("2026-12-21T12:00:00Z"))
        assert np.flatnonzero((south == 0).any(axis=1)).mean() > (HEIGHT - 1) / 2
        assert rig.friend.count_subscribers("/shadow_tracer/lights/lamp/pose") == 0  # nobody moves the sun


def test_at_night_it_is_dark_which_is_not_unknown() -> None:
    pytest.importorskip("ephem")
    parameters = {**THREE, **EAST_NORTH_UP, **PLACE, "light_names": ["lamp"], "mask.publish": "always"}
    with Rig(parameters) as rig:
        bits = rig.collect(Image, "shadow_tracer/light_bits")
        rig.listen_to_light("lamp")
        stamp = rig.send_frame(wall(), stamp=ns("2026-06-21T23:30:00Z"))
        dark = rig.mask_of(stamp)
        assert dark[0, 0] == UNKNOWN and (dark.ravel()[1:] == 0).all()
        np.testing.assert_array_equal(rig.mask_of(stamp, "lamp"), dark)
        rig.until(lambda: bits)
        assert not any(bits[-1].data)
        timing = rig.until(lambda: rig.timings and rig.timings[-1])
        assert timing.status[0].level == OK
        rig.wait_status(PROCESSING, OK)
        # With another light beside it the sun is 0 everywhere, and the mask of all is that of the other.
        assert rig.set(light_names=["lamp", "sky"]) == ""
        assert rig.set(lights__sky__type="directional", lights__sky__direction=[0, 0, -1]) == ""
        rig.listen_to_light("sky")
        stamp = rig.send_frame(wall(), stamp=ns("2026-06-21T23:31:00Z"))
        assert (rig.mask_of(stamp, "sky").ravel()[1:] == 255).all()
        np.testing.assert_array_equal(rig.mask_of(stamp, "lamp"), dark)
        np.testing.assert_array_equal(rig.mask_of(stamp), rig.mask_of(stamp, "sky"))
        rig.until(lambda: len(bits) > 1)
        pixels = np.frombuffer(bits[-1].data, np.uint8)
        assert pixels[0] == 0 and (pixels[1:] == 2).all()


def test_a_sphere_casts_soft_shadows(tracer: ShadowTracer) -> None:
    parameters = {"mask.unknown_value": UNKNOWN, "lights.lamp.type": "sphere", "lights.lamp.radius": 0.2}
    with Rig(parameters) as rig:
        bits = rig.collect(Image, "shadow_tracer/light_bits")
        rig.send_mesh(*plate())
        for radius, reach in ((0.2, 0.0), (0.05, 2.2)):
            assert rig.set(lights__lamp__radius=radius, lights__lamp__range=reach) == ""
            frame = expected(tracer, SphereLight("lamp", (0.5, -0.5, 0.0), radius, range=reach or math.inf))
            stamp = rig.send_frame(wall())
            mask = rig.mask_of(stamp)
            np.testing.assert_array_equal(mask, frame.mask(unknown=UNKNOWN))
            assert {0, 255} < set(mask.ravel().tolist()) - {UNKNOWN} and np.isin(mask, range(1, 255)).sum() > 20
            msg = rig.until(lambda: next((m for m in bits if nanoseconds(m.header.stamp) == stamp), None))  # noqa: B023
            np.testing.assert_array_equal(bits_of(msg), frame.bits())
            assert ((bits_of(msg) == 1) & (mask < 255) & (mask > 0)).any()  # some of it reaches
        place(rig, "lamp", (-0.4, 0.3, 0.1))
        sphere = SphereLight("lamp", (-0.4, 0.3, 0.1), 0.05, range=2.2)
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, sphere).mask(unknown=UNKNOWN))


SHAPES: dict[str, tuple[dict[str, Any], Any]] = {
    "disc": ({"radius": 0.2}, DiscLight("lamp", (0.5, -0.5, 0.0), (0, 0, 1), 0.2)),
    "rectangle": ({"size": [0.4, 0.2]}, RectangleLight("lamp", (0.5, -0.5, 0.0), (0.2, 0, 0), (0, 0.1, 0))),
    "tube": ({"length": 0.5, "radius": 0.02}, TubeLight("lamp", (0.25, -0.5, 0.0), (0.75, -0.5, 0.0), 0.02)),
    "directional": ({"angular_diameter": 0.1}, SunDisc("lamp", (0, 0, 1), 0.1)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_the_part_of_a_light_that_is_seen(tracer: ShadowTracer, kind: str) -> None:
    """32FC1, the library's numbers bit for bit, NaN where nothing is known, with a camera_info beside it; whatever
    becomes of masks."""
    group, light = SHAPES[kind]
    parameters = {f"lights.lamp.{key}": value for key, value in {"type": kind, **group}.items()}
    with Rig({**parameters, "camera_info_policy": "exact", "mask.dilate": 3, "mask.invert": True}) as rig:
        shares = rig.collect(Image, "shadow_tracer/visibility/lamp")
        infos = [rig.collect(CameraInfo, f"shadow_tracer/visibility/{where}camera_info") for where in ("", "lamp/")]
        rig.send_mesh(*plate())
        depth = wall()
        depth[0, 0] = np.nan
        stamp = rig.send_frame(depth)
        msg = rig.until(lambda: next((m for m in shares if nanoseconds(m.header.stamp) == stamp), None))
        assert (msg.encoding, msg.step, msg.header.frame_id) == ("32FC1", 4 * WIDTH, "camera")
        share = np.frombuffer(msg.data, np.float32).reshape(HEIGHT, WIDTH)
        frame = tracer.trace(depth, camera(), [light], bias=BIAS)
        np.testing.assert_array_equal(share, frame.visibility("lamp"))
        assert np.isnan(share[0, 0]) and ((share > 0) & (share < 1)).sum() > 20
        for heard in infos:
            info = rig.until(lambda: heard and heard[-1])  # noqa: B023
            assert nanoseconds(info.header.stamp) == stamp and info.width == WIDTH
        before = len(shares)
        stamp = rig.send_frame(wall(), info=False)  # nothing is known
        msg = rig.until(lambda: next((m for m in shares[before:] if nanoseconds(m.header.stamp) == stamp), None))
        assert np.isnan(np.frombuffer(msg.data, np.float32)).all()
        assert rig.set(light_names=["sky"]) == ""
        assert "lamp" not in rig.core.outputs.cameras[""].shares and set(rig.core.outputs.cameras[""].infos) == {
            f"{kind}/{name}" for kind in ("mask", "visibility", "irradiance") for name in ("", "sky/")
        }


def irradiance_of(rig: Rig, heard: list[Any], stamp: int) -> np.ndarray:
    msg = rig.until(lambda: next((m for m in heard if nanoseconds(m.header.stamp) == stamp), None))
    assert (msg.encoding, msg.step, msg.header.frame_id) == ("32FC1", 4 * WIDTH, "camera")
    return np.frombuffer(msg.data, np.float32).reshape(HEIGHT, WIDTH)


def test_irradiance_of_lights_with_a_strength(tracer: ShadowTracer) -> None:
    """The library's numbers bit for bit; NaN where nothing is known and of lights that have no strength; ``output``
    changes while the node runs; the depth image as occluder leaves normals to its fitted planes."""
    lamp = DiscLight("lamp", (0.5, -0.5, 0.0), (0, 0, 1), 0.2, strength=Strength(power=4.0))
    parameters = {"light_names": ["lamp", "dark"], "lights.lamp.type": "disc", "lights.lamp.radius": 0.2}
    with Rig({**parameters, "lights.lamp.power": 4.0}) as rig:
        heard = {name: rig.collect(Image, f"shadow_tracer/irradiance{name}") for name in ("", "/lamp", "/dark")}
        rig.send_mesh(*plate())
        depth = wall()
        depth[0, 0] = np.nan
        stamp = rig.send_frame(depth)
        found = {name: irradiance_of(rig, messages, stamp) for name, messages in heard.items()}
        expected = tracer.trace(depth, camera(), [lamp], bias=BIAS).irradiance("lamp")
        np.testing.assert_array_equal(found["/lamp"], expected)
        np.testing.assert_array_equal(found[""], expected)
        assert np.isnan(found["/dark"]).all() and np.isnan(expected[0, 0]) and (expected > 0.0).sum() > 100
        assert rig.set(lights__lamp__output=0.5) == ""
        stamp = rig.send_frame(depth)
        np.testing.assert_allclose(irradiance_of(rig, heard["/lamp"], stamp), 0.5 * expected, rtol=1e-6)
        assert "power" in rig.set(lights__lamp__intensity=1.0)
        assert rig.set(lights__lamp__type="directional").startswith("lights.lamp.power: a DirectionalLight has none")
        assert rig.set(occluders="depth") == ""
        stamp = rig.send_frame(depth)
        lit = irradiance_of(rig, heard["/lamp"], stamp)
        assert np.nanmedian(lit) == pytest.approx(0.5 * np.nanmedian(expected[expected > 0.0]), rel=0.5)


def test_a_tube_and_a_panel_follow_the_pose_of_their_topic(tracer: ShadowTracer) -> None:
    """The pose's x is where a panel shines, its y the axis."""
    with Rig({"lights.lamp.type": "rectangle", "lights.lamp.size": [0.2, 0.4]}) as rig:
        rig.send_mesh(*plate())
        place(rig, "lamp", (-0.4, 0.3, 0.1), ALONG_Z)
        panel = RectangleLight("lamp", (-0.4, 0.3, 0.1), (0, 0.1, 0), (-0.2, 0, 0))
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, panel).mask())
        assert rig.set(lights__lamp__type="tube", lights__lamp__length=0.5, lights__lamp__radius=0.0) == ""
        place(rig, "lamp", (-0.4, 0.3, 0.1), ALONG_Z)
        tube = TubeLight("lamp", (-0.4, 0.05, 0.1), (-0.4, 0.55, 0.1))
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, tube).mask())
        assert "lights.lamp.radius" in rig.set(lights__lamp__type="disc")


def test_what_a_light_ignores(tracer: ShadowTracer) -> None:
    """The plate casts shadow in one light and not in the other; a name that no part has is reported."""
    names = ["lamp", "other"]
    with Rig({"light_names": names, "lights.lamp.ignore": ["mesh"]}) as rig:
        rig.listen_to_light("lamp")
        rig.listen_to_light("other")
        rig.send_mesh(*plate())
        stamp = rig.send_frame(wall())
        frame = expected(tracer, PointLight("other", (0.5, -0.5, 0.0)))
        assert (rig.mask_of(stamp, "lamp") == np.where(np.isfinite(wall()) & (wall() > 0), 255, 0)).all()
        np.testing.assert_array_equal(rig.mask_of(stamp, "other"), frame.mask())
        rig.wait_status(PROCESSING, OK)
        assert rig.set(lights__lamp__ignore=["shade"]) == ""
        stamp = rig.send_frame(wall())
        np.testing.assert_array_equal(rig.mask_of(stamp, "lamp"), frame.mask())
        rig.wait_status(PROCESSING, WARN, "lights.lamp.ignore names 'shade', but the parts are mesh, depth")


def test_a_part_that_casts_no_shadow(tracer: ShadowTracer) -> None:
    """It gives normals as before; and begins to cast when it is no longer named."""
    with Rig({"mesh.cast_no_shadows": ["mesh"], "lights.lamp.power": 4.0}) as rig:
        heard = rig.collect(Image, "shadow_tracer/irradiance/lamp")
        rig.send_mesh(*plate())
        stamp = rig.send_frame(wall())
        light = PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(power=4.0))
        tracer.scene.cast_shadows("mesh", False)
        frame = tracer.trace(wall(), camera(), [light], bias=BIAS)
        seen = frame.irradiance()
        tracer.scene.cast_shadows("mesh", True)
        np.testing.assert_array_equal(rig.mask_of(stamp), frame.mask())
        np.testing.assert_array_equal(irradiance_of(rig, heard, stamp), seen)
        assert (frame.mask() == np.where(np.isfinite(wall()) & (wall() > 0), 255, 0)).all()
        assert rig.set(mesh__cast_no_shadows=["markers", "mesh"]) == ""
        rig.trace(wall())
        rig.wait_status(PROCESSING, WARN, "mesh.cast_no_shadows names 'markers', but the parts are mesh")
        assert rig.set(mesh__cast_no_shadows=[""]) == ""
        np.testing.assert_array_equal(rig.trace(wall()), expected(tracer, light).mask())


def test_a_light_that_becomes_the_sun_leaves_the_pose_of_its_topic() -> None:
    pytest.importorskip("ephem")
    with Rig({**THREE, **EAST_NORTH_UP, "light_names": ["lamp"]}) as rig:
        rig.send_mesh(*below())
        place(rig, "lamp", (0.1, 0.2, 3.0), frame="elsewhere")
        assert all_unknown(rig.trace(wall()))
        assert rig.set(**{name.replace(".", "__"): value for name, value in PLACE.items()}) == ""
        assert rig.set(lights__lamp__sun__time=NOON) == ""
        assert shadow_size(rig.trace(wall()))


def test_a_sun_that_cannot_be_computed_is_unknown_and_says_what_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig({**THREE, **EAST_NORTH_UP, **PLACE, "light_names": ["lamp"]}) as rig:
        monkeypatch.setitem(sys.modules, "ephem", None)
        assert all_unknown(rig.trace(wall(), stamp=ns(NOON)))
        rig.wait_status(PROCESSING, ERROR, "lights.lamp: the position of the sun needs ephem: pip install")
        monkeypatch.undo()
        pytest.importorskip("ephem")
        assert not all_unknown(rig.trace(wall(), stamp=ns(NOON) + 1))


def bits_of(msg: Image) -> np.ndarray:
    kind = {"mono8": np.uint8, "16UC1": np.uint16}[msg.encoding]
    assert not msg.is_bigendian and msg.step == msg.width * np.dtype(kind).itemsize
    return np.frombuffer(msg.data, kind).reshape(msg.height, msg.width)


@pytest.mark.parametrize("count", [3, 8, 9, pytest.param(16, marks=pytest.mark.slow)])
def test_light_bits_follow_the_parameter_lights(tracer: ShadowTracer, count: int) -> None:
    """Bit i is light i of the parameter, whichever are disabled; more than 8 lights need 16 bits."""
    names = [f"l{k}" for k in range(count)]
    positions = [(0.5 - 0.1 * k, -0.5 + 0.05 * k, 0.0) for k in range(count)]
    parameters: dict[str, Any] = {"light_names": names}
    parameters |= {f"lights.{name}.position": list(where) for name, where in zip(names, positions, strict=True)}
    parameters |= {f"lights.{name}.enabled": k != 1 for k, name in enumerate(names)}
    with Rig(parameters) as rig:
        messages = rig.collect(Image, "shadow_tracer/light_bits")
        rig.send_mesh(*plate())
        stamp = rig.send_frame(wall())
        msg = rig.until(lambda: next((m for m in messages if nanoseconds(m.header.stamp) == stamp), None))
        assert msg.encoding == ("mono8" if count <= 8 else "16UC1")
        bits = bits_of(msg)
        shining = [k for k in range(count) if k != 1]
        frame = expected(tracer, *(PointLight(names[k], positions[k]) for k in shining))
        for k in range(count):
            reached = frame.mask(names[k]) == 255 if k in shining else np.zeros(bits.shape, bool)
            np.testing.assert_array_equal((bits >> k & 1).astype(bool), reached)
        assert not (bits >> count).any()


@pytest.mark.slow
def test_more_lights_than_bits_have_masks_but_no_bits(tracer: ShadowTracer) -> None:
    names = [f"l{k}" for k in range(17)]
    with Rig({"light_names": names, "bounds.max_lights": 17, "mask.publish": "always"}) as rig:
        messages = rig.collect(Image, "shadow_tracer/light_bits")
        rig.send_mesh(*plate())
        frame = library_of(17).trace(wall(), camera(), [PointLight(n, (0.5, -0.5, 0.0)) for n in names], bias=BIAS)
        np.testing.assert_array_equal(rig.trace(wall()), frame.mask())
        rig.wait_status(PROCESSING, WARN, "light_bits has 16 bits and is not published for 17 lights")
        assert not messages


def library_of(lights: int) -> ShadowTracer:
    """A tracer for so many lights."""
    from shadow_tracer import Bounds

    made = ShadowTracer(device="cpu", bounds=Bounds(4096, 128 * 96, lights, 16384))
    made.scene.put("mesh", *plate())
    return made


def test_masks_are_made_for_listeners_or_always() -> None:
    with Rig(THREE) as rig:
        sent: list[str] = []
        outputs = rig.core.outputs.cameras[""]
        for publisher in (outputs.mask, outputs.bits, outputs.overlay, *outputs.lights.values()):
            publish = publisher.publish
            name = publisher.topic_name.removeprefix("/shadow_tracer/")
            publisher.publish = lambda msg, name=name, publish=publish: (sent.append(name), publish(msg))
        rig.trace(wall())
        assert sent == ["mask"]  # somebody listens to this one
        sent.clear()
        assert rig.set(mask__publish="always") == ""
        rig.trace(wall())
        assert sorted(sent) == ["light_bits", "mask", "mask/lamp", "mask/sky", "mask/spot"]
        assert rig.set(mask__publish="listened") == ""
        rig.listen_to_light("spot")
        sent.clear()
        stamp = rig.send_frame(wall())
        rig.mask_of(stamp, "spot")
        rig.mask_of(stamp)
        assert sorted(sent) == ["mask", "mask/spot"]


def test_the_overlay_shows_what_is_known(rig: Rig) -> None:
    images = rig.collect(Image, "shadow_tracer/overlay")

    def shown(**how: Any) -> np.ndarray:
        stamp = rig.send_frame(wall(), **how)
        msg = rig.until(lambda: next((m for m in images if nanoseconds(m.header.stamp) == stamp), None))
        assert (msg.encoding, msg.step, msg.header.frame_id) == ("rgb8", 3 * WIDTH, "camera")
        return np.frombuffer(msg.data, np.uint8).reshape(HEIGHT, WIDTH, 3)

    assert rig.set(light_names=["lamp"], camera_info_policy="exact") == ""
    centre = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    first = shown()
    np.testing.assert_array_equal(first, overlay(wall(), rig.trace(wall()), FOCAL, FOCAL, *centre))
    unknown = shown(info=False)  # it does not stand still: nobody may take the last picture for the present
    np.testing.assert_array_equal(unknown, overlay(wall(), None, WIDTH, WIDTH, *centre))
    assert not np.array_equal(first, unknown)


STRENGTHS: list[tuple[dict[str, Any], Any]] = [
    ({"power": 4.0}, PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(power=4.0))),
    ({"intensity": 2.0}, PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(intensity=2.0))),
    (
        {"type": "disc", "radius": 0.2, "exitance": 30.0, "model": "isotropic", "output": 0.5},
        DiscLight(
            "lamp", (0.5, -0.5, 0.0), (0, 0, 1), 0.2, strength=Strength(exitance=30.0, model="isotropic", output=0.5)
        ),
    ),
    (
        {"type": "directional", "irradiance": 900.0},
        DirectionalLight("lamp", (0, 0, 1), strength=Strength(irradiance=900.0)),
    ),
]


def test_every_parameter_of_a_strength(tracer: ShadowTracer) -> None:
    with Rig() as rig:
        heard = rig.collect(Image, "shadow_tracer/irradiance/lamp")
        rig.send_mesh(*plate())
        for group, light in STRENGTHS:
            assert rig.set(**{f"lights__lamp__{key}": value for key, value in group.items()}) == ""
            found = irradiance_of(rig, heard, rig.send_frame(wall()))
            expected = tracer.trace(wall(), camera(), [light], bias=BIAS).irradiance()
            np.testing.assert_array_equal(found, expected)
            assert (found > 0.0).sum() > 100
            off = {"type": "point", **{key: default_of(f"lights.lamp.{key}") for key in group}}
            assert rig.set(**{f"lights__lamp__{key}": value for key, value in off.items()}) == ""


def test_a_light_of_an_ies_file(tracer: ShadowTracer, tmp_path: Path) -> None:
    """Refused, with the light as it was, while the unit is missing."""
    pytest.importorskip("photompy")
    path = lamps.ies(tmp_path, (0, 90, 180, 270, 360), [[9, 1, 0], [9, 2, 1], [9, 3, 1], [9, 4, 1], [9, 1, 0]])
    with Rig({"lights.lamp.intensity": 2.0}) as rig:
        heard = rig.collect(Image, "shadow_tracer/irradiance/lamp")
        rig.send_mesh(*plate())
        before = irradiance_of(rig, heard, rig.send_frame(wall()))
        assert "lights.lamp.ies.unit: expected one of" in rig.set(lights__lamp__ies__file=str(path))
        np.testing.assert_array_equal(irradiance_of(rig, heard, rig.send_frame(wall())), before)
        wish = {"intensity": 0.0, "ies__file": str(path), "ies__unit": "cd", "ies__lumens_per_watt": 300.0}
        assert rig.set(**{f"lights__lamp__{key}": value for key, value in wish.items()}) == ""
        table = IntensityTable.from_ies(path, "cd", 300.0, (0, 0, 1), (1, 0, 0))
        light = PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(model=table))
        found = irradiance_of(rig, heard, rig.send_frame(wall()))
        np.testing.assert_array_equal(found, tracer.trace(wall(), camera(), [light], bias=BIAS).irradiance())
        assert (found > 0.0).sum() > 100
