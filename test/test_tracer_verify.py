# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.verify: the answer held against that of a second pipeline, which must notice what is wrong and leave the
first as it was."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import (
    Bounds,
    Camera,
    DirectionalLight,
    PointLight,
    Scene,
    ShadowTracer,
    SphereLight,
    SpotLight,
    State,
    available_pipelines,
)

_BOUNDS = Bounds(max_triangles=3000, max_rays=2000, max_lights=4, queue_capacity=4000, grid_entries=20_000)
_CAMERA = Camera(40, 30, 35.0, 36.0, 19.25, 14.75, geometry.look_at((-8.0, 0.3, 2.0), (0.0, 0.0, 1.0), (0, 0, 1)))
_LIGHTS: list[Any] = [
    PointLight("lamp", (0.5, 0.2, 2.5), range=9.0),
    SpotLight("spot", (-3.0, 0.0, 4.0), (1.0, 0.0, -1.5), 0.6),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]
_PAIRS = [
    ("light_grid/packed", None, probe.USUAL),
    ("light_grid/packed", "cone_hierarchy", probe.CUDA),
    ("light_grid/spherical", "brute_force", probe.USUAL),
    ("mesh_bvh/refit", None, probe.USUAL),
    ("mesh_bvh/rebuild", "cone_hierarchy", probe.USUAL),
    ("cone_hierarchy/linear", "light_grid", probe.USUAL),
    ("brute_force/filtered", "light_grid", probe.USUAL),
]
_pairs = pytest.mark.parametrize(("names", "against", "kernel_form"), _PAIRS, indirect=["kernel_form"])


def _street() -> geometry.Geometry:
    return geometry.street(np.random.default_rng(80), 50)


def _depth(seed: int = 120) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 16.0, (30, 40)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    return depth


def _tracer(names: str, device: str, graphs: bool | None = None) -> ShadowTracer:
    tracer = ShadowTracer(*names.split("/"), device=device, bounds=_BOUNDS, graphs=graphs)
    tracer.scene.put("street", *_street())
    return tracer


@_pairs
def test_right_answers_differ_nowhere_and_stay_right(any_device: str, names: str, against: str | None) -> None:
    """Frames in which everything changes, with and without a verification after each: the same bits, no difference."""
    tracer, alone = _tracer(names, any_device, True), _tracer("brute_force", any_device)
    rng = np.random.default_rng(121)
    vertices, triangles = geometry.icosphere(2, 0.7)
    for step in range(10):
        for each in (tracer, alone):
            if step != 5:  # once with nothing changed but the image
                each.scene.put("body", vertices * (1.0 + 0.03 * step), triangles)
            if step == 3:
                each.scene.put("body", *geometry.icosphere(1, 0.9))
            if step == 7:
                each.scene.remove("street")
        lights = _LIGHTS[: 1 + step % 3]
        if step == 6:
            lights = [PointLight("moved", rng.uniform((-3, -2, 2), (3, 2, 4)))]
        depth = _depth(130 + step) if step % 2 else (1000.0 * np.nan_to_num(_depth(130 + step))).astype(np.uint16)
        frame = tracer.trace(depth, _CAMERA, lights)
        if step not in (2, 8):  # the second pipeline misses some changes
            assert tracer.verify(depth, _CAMERA, lights, against=against) == 0
        expected = alone.trace(depth, _CAMERA, lights)
        again = tracer.trace(depth, _CAMERA, lights)
        assert frame.differing(expected) == 0 and again.differing(expected) == 0
        assert {State.LIT, State.SHADOWED} <= set(np.unique(expected.state(lights[0].name))) or step >= 7


@_pairs
def test_verify_alone_traces_for_itself(
    any_device: str, names: str, against: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracer = _tracer(names, any_device)
    traces = probe.depth_traces(monkeypatch)
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS, against=against) == 0
    assert len(traces) == 2 and len(set(traces)) == 2


def test_a_changed_answer_is_counted(any_device: str) -> None:
    """Every wrong (pixel, light) pair counts once, whatever is wrong about it."""
    tracer = _tracer("light_grid", any_device)
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS)
    held = probe.states(frame)
    held[2, 3, 4:9] = 7
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 5
    places = np.argwhere(held[0] == State.SHADOWED)[:11]
    held[0][tuple(places.T)] = State.LIT
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 16
    tracer.trace(_depth(), _CAMERA, _LIGHTS)
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0


@pytest.mark.parametrize("names", ["light_grid/packed", "mesh_bvh/refit", "cone_hierarchy/linear"])
@pytest.mark.parametrize("wrong", ["first", "second"])
def test_a_blind_pipeline_is_found_out(any_device: str, names: str, wrong: str) -> None:
    """A pipeline that finds no occluder, be it the first or the second: every shadow is a difference."""
    tracer = _tracer(names, any_device)
    shadows = sum(
        int((tracer.trace(_depth(), _CAMERA, _LIGHTS).state(light.name) == State.SHADOWED).sum()) for light in _LIGHTS
    )
    assert shadows > 100
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0
    pipeline = probe.pipeline(tracer) if wrong == "first" else probe.verifying_pipeline(tracer)
    pipeline.show = lambda *_: None
    tracer.trace(_depth(), _CAMERA, _LIGHTS)
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == shadows


def test_wrong_records_of_the_first_are_not_inherited(any_device: str) -> None:
    """The second pipeline makes triangle records of its own: damaged ones of the first show."""
    tracer = _tracer("mesh_bvh", any_device)
    tracer.trace(_depth(), _CAMERA, _LIGHTS[2:])
    records = probe.context(tracer).records.memory
    # Within each record: not all triangles have one, and what lies between is whatever lay there.
    records.assign(np.ascontiguousarray(np.roll(records.numpy(), 1, axis=1)))  # planes in the place of others
    tracer.trace(_depth(), _CAMERA, _LIGHTS[2:])  # nothing has changed: by the records that are there
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS[2:]) > 50
    tracer.trace(_depth(), _CAMERA, _LIGHTS[2:])
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS[2:]) == 0, "they are made again after a difference"


def _new_light(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    given["lights"] = [PointLight("lamp", (0.5, 0.2, 2.5), range=9.0), *_LIGHTS[1:]]


def _other_bits(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    given["depth"][2, 3] += np.float32(1e-6)


def _other_unit(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    given["depth"] = (1000.0 * np.nan_to_num(given["depth"])).astype(np.uint16)


def _moved(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    tracer.scene.move("street", geometry.pose_of(np.eye(3), (0.1, 0.0, 0.0)))


def _other_scene(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    tracer.scene = Scene(tracer.bounds)


def _culling(tracer: ShadowTracer, given: dict[str, Any]) -> None:
    tracer.front_face_culling = True


_CHANGES: list[Any] = [
    _new_light,
    _other_bits,
    _other_unit,
    _moved,
    _other_scene,
    _culling,
    lambda tracer, given: given.update(bias=0.02),
    lambda tracer, given: given.update(camera=Camera(40, 30, 35.0, 36.0, 19.25, 14.75)),
    lambda tracer, given: given.update(lights=_LIGHTS[::-1]),
    lambda tracer, given: tracer.warm_up(),
    lambda tracer, given: tracer.select("cone_hierarchy"),
]


def test_the_last_answer_is_used_if_it_is_of_these_inputs(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then a verification is one trace by the second pipeline; whatever has changed, it is two."""
    tracer = _tracer("light_grid", any_device)
    tracer.prepare_verify()
    traces = probe.depth_traces(monkeypatch)
    for change in (None, *_CHANGES):
        given: dict[str, Any] = {"depth": _depth(), "camera": _CAMERA, "lights": _LIGHTS, "bias": 0.01}
        tracer.trace(**given)
        given["depth"] = given["depth"].copy()  # the same bits in another place
        traces.clear()
        if change is None:
            tracer.occluded(np.zeros((5, 3)), _LIGHTS[0])
            tracer.states_at(np.zeros((7, 3)), _LIGHTS)
        else:
            change(tracer, given)
            traces.clear()
        assert tracer.verify(**given) == 0
        assert len(traces) == (1 if change is None else 2), (change, traces)
        assert traces[-1] == "Judge"


_WIDE = Camera(256, 160, 200.0, 200.0, 127.5, 79.5, _CAMERA.camera_to_world)
_WIDE_BOUNDS = Bounds(max_triangles=3000, max_rays=44000, max_lights=4, queue_capacity=4000, grid_entries=20_000)


def _wide_depth(seed: int) -> np.ndarray:
    """The upper rows hold nothing, so that shares do not lie where a single one's pixels do."""
    depth = np.random.default_rng(seed).uniform(0.5, 16.0, (160, 256)).astype(np.float32)
    depth[:50] = np.nan
    return depth


@pytest.mark.parametrize("names", ["light_grid", "auto", "mesh_bvh"])
@pytest.mark.parametrize("threads", [1, 2])
def test_points_in_between_change_neither_the_image_nor_the_answer(
    names: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another image than the last one is traced, though points were asked about in between; the same one is not, though
    it was verified before."""
    tracer = ShadowTracer(names, device="cpu", bounds=_WIDE_BOUNDS, threads=threads)
    tracer.scene.put("street", *_street())
    tracer.prepare_verify("cone_hierarchy")
    depth = _wide_depth(170)
    other = depth.copy()
    other[60:] = _wide_depth(171)[60:]
    traces = probe.depth_traces(monkeypatch)
    chooser = probe.chooser(tracer)
    assert (chooser is not None) == (names == "auto")
    for image, expected in ((depth, 1), (depth, 1), (other, 2)):
        if chooser:
            chooser.forced = ("light_grid", "packed")
        if image is other or not traces:
            tracer.trace(depth, _WIDE, _LIGHTS)
        if chooser:
            chooser.forced = ("brute_force", "filtered")
        tracer.occluded([[0.0, 0.0, 1.0]], _LIGHTS[0])
        traces.clear()
        assert tracer.verify(image, _WIDE, _LIGHTS) == 0
        assert len(traces) == expected


def test_an_image_of_the_other_format_is_not_the_last_one(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Millimetres, then metres, then the same millimetres, which still are where they were."""
    tracer = _tracer("light_grid", any_device)
    millimetres = (1000.0 * np.nan_to_num(_depth())).astype(np.uint16)
    tracer.trace(millimetres, _CAMERA, _LIGHTS)
    tracer.trace(_depth(5), _CAMERA, _LIGHTS)
    traces = probe.depth_traces(monkeypatch)
    assert tracer.verify(millimetres, _CAMERA, _LIGHTS) == 0
    assert len(traces) == 2


def test_an_answer_is_forgotten_when_the_next_frame_fails(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was of the image before; and an image of which no answer is known is traced, be it where it should be."""
    tracer = _tracer("light_grid", any_device)
    tracer.prepare_verify()
    tracer.trace(_depth(), _CAMERA, _LIGHTS)
    with monkeypatch.context() as patch:
        probe.before_launches(patch, lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            tracer.trace(_depth(6), _CAMERA, _LIGHTS)
    traces = probe.depth_traces(monkeypatch)
    assert tracer.verify(_depth(6), _CAMERA, _LIGHTS) == 0
    assert len(traces) == 2


@pytest.mark.parametrize("names", ["light_grid", "auto"])
def test_auto_verifies_nobody_and_nobody_it_may_choose_verifies_it(names: str, any_device: str) -> None:
    tracer = _tracer(names, any_device)
    for call in (tracer.prepare_verify, lambda against: tracer.verify(_depth(), _CAMERA, _LIGHTS, against=against)):
        with pytest.raises(ValueError, match="^against: expected one of cone_hierarchy,? .*got 'auto'"):
            call("auto")
    if names == "auto":
        mine = ("mesh_bvh", "light_grid", "brute_force")
        others = ", ".join(name for name in available_pipelines() if name not in (*mine, "auto"))
        for against in mine:
            with pytest.raises(ValueError, match=f"^against: expected one of {others}, got '{against}'"):
                tracer.prepare_verify(against)
        assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0 and probe.verifier(tracer) == "cone_hierarchy"
    else:
        tracer.prepare_verify("brute_force")
        tracer.select("auto")
        assert probe.verifier(tracer) is None, "auto may choose it for a frame"
        assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0


def test_buffers_of_the_second_pipeline(any_device: str) -> None:
    """Allocated once, by the first verification or by prepare_verify; counted; freed when told, and when the first
    pipeline becomes the same."""
    tracer = _tracer("light_grid", any_device)
    tracer.trace(_depth(), _CAMERA, _LIGHTS)
    plain = tracer.device_bytes
    assert tracer.prepare_verify() >= 0.0
    assert tracer.device_bytes > plain
    second: Any = probe.verifying_pipeline(tracer)
    tracer.trace(_depth(), _CAMERA, _LIGHTS)
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0
    both = tracer.device_bytes
    for seed in range(140, 150):
        tracer.scene.put("street", *_street())
        assert tracer.verify(_depth(seed), _CAMERA, _LIGHTS) == 0
    assert tracer.device_bytes == both and probe.verifying_pipeline(tracer) is second
    del second
    tracer.release_verify()
    assert tracer.device_bytes == plain
    tracer.release_verify()
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS, against="brute_force") == 0
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0 and probe.verifier(tracer) == "brute_force", "it is kept"
    tracer.prepare_verify("mesh_bvh")
    tracer.select("mesh_bvh")
    assert probe.verifier(tracer) is None
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS) == 0 and probe.verifier(tracer) == "light_grid"
    tracer.select("light_grid", "spherical")
    assert probe.verifier(tracer) is None


def test_a_prepared_second_pipeline_leaves_the_scene_alone(any_device: str) -> None:
    tracer = _tracer("light_grid", any_device)
    expected = tracer.trace(_depth(), _CAMERA, _LIGHTS)
    revision = tracer.scene.revision
    tracer.prepare_verify()
    assert tracer.scene.revision == revision
    assert tracer.trace(_depth(), _CAMERA, _LIGHTS).differing(expected) == 0


def test_errors_name_the_argument(any_device: str) -> None:
    tracer = _tracer("light_grid", any_device)
    others = ", ".join(name for name in available_pipelines() if name not in ("light_grid", "auto"))
    for against in ("light_grid", "cone", ""):
        for call in (
            lambda name: tracer.verify(_depth(), _CAMERA, _LIGHTS, against=name),
            lambda name: tracer.prepare_verify(name),
        ):
            with pytest.raises(ValueError, match=f"^against: expected one of {others}, got "):
                call(against)
    for field, change in (
        ("depth", {"depth": _depth()[:5]}),
        ("camera", {"camera": None}),
        ("lights", {"lights": []}),
        ("bias", {"bias": -1.0}),
    ):
        arguments: dict[str, Any] = {"depth": _depth(), "camera": _CAMERA, "lights": _LIGHTS, "bias": 0.01, **change}
        with pytest.raises(ValueError, match=f"^{field}"):
            tracer.verify(**arguments)
    assert probe.verifier(tracer) is None, "nothing was allocated for a call that was refused"


def test_frames_of_other_lights_or_sizes_cannot_be_compared(any_device: str) -> None:
    tracer = _tracer("light_grid", any_device)
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS)
    small = Camera(20, 15, 35.0, 36.0, 19.25, 14.75)
    for other in (
        tracer.trace(_depth(), _CAMERA, _LIGHTS[::-1]),
        tracer.trace(_depth()[::2, ::2].copy(), small, _LIGHTS),
    ):
        with pytest.raises(ValueError, match="^other: expected"):
            frame.differing(other)


def test_frames_of_a_point_and_a_sphere_of_one_name_cannot_be_compared(any_device: str) -> None:
    tracer = _tracer("light_grid", any_device)
    position = (0.5, 0.2, 2.5)
    lights = PointLight("lamp", position), *(SphereLight("lamp", position, 0.1, samples=n) for n in (4, 5))
    frames = [tracer.trace(_depth(), _CAMERA, [light]) for light in lights]
    for one in frames:
        assert one.differing(one) == 0
        for other in frames:
            if one is not other:
                with pytest.raises(ValueError, match="^other: expected a frame with samples of lights"):
                    one.differing(other)
