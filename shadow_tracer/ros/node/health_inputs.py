# SPDX-License-Identifier: Apache-2.0
"""The two statuses of ``/diagnostics`` about what comes in: depth images, and meshes. No ROS here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from shadow_tracer.ros.diagnostics import ERROR, OK, WARN
from shadow_tracer.ros.node.installed import config_file
from shadow_tracer.ros.node.transport import LARGE
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.parts import FILES
from shadow_tracer.ros.world.mesh_sources import TOPICS

if TYPE_CHECKING:
    from shadow_tracer.ros.node.camera_input import CameraInput
    from shadow_tracer.ros.node.health_camera import CameraHealth
    from shadow_tracer.ros.node.inputs import Inputs

_SILENT = 3.0  # seconds after which an input counts as silent
_MUCH = 0.1  # share of images that the transport may lose before it is said

Verdict = tuple[bytes, str, dict[str, Any]]


def judge_depth(camera: CameraHealth, now: float) -> Verdict:
    """The status ``input depth`` of a camera.

    Args:
        now: steady time [s].
    """
    inputs = camera.input
    depth, topic = inputs.depth, inputs.topic("depth")
    rate, age = depth.rate(now), depth.age(now)
    lost, sent = inputs.losses.lost_share(now, camera.busy.mean())
    values = {
        "topic": topic,
        "camera_info topic": inputs.topic("info"),
        "rate [Hz]": f"{rate:.1f}",
        "age [s]": f"{age:.2f}",
        "format": inputs.format,
        "distortion": camera.model or "none",
        "received": depth.count,
        "refused": inputs.refused.count,
        "last refusal": inputs.refused.text or "-",
        "skipped before the node": inputs.losses.skipped,
        "lost by the transport [%]": f"{100 * lost:.0f}",
    }
    values |= camera.values() if inputs.name else {}
    if not inputs.listening:
        return OK, "not listening: the node is not active", values
    mismatch = inputs.mismatch("depth", "info")
    if mismatch:
        return ERROR, mismatch, values
    if inputs.refused.recent(now):
        return ERROR, f"image refused, {inputs.refused.text}; correct the publisher of {topic}", values
    if age > _SILENT:
        name = f"set cameras.{inputs.name}.depth_topic" if inputs.name else "remap depth/image_rect"
        hint = f"see `ros2 topic hz {topic}`, or {name} to the topic of the camera"
        if depth.count == 0:
            return WARN, f"no depth image on {topic}; {hint}", values
        return WARN, f"no depth image for {age:.0f} s on {topic}; {hint}", values
    if lost > _MUCH:
        return WARN, _loss(inputs, lost, sent), values
    if camera.warning:
        return WARN, camera.warning, values
    return OK, f"{inputs.format} at {rate:.1f} Hz", values


def _loss(inputs: CameraInput, share: float, rate: float) -> str:
    topic = inputs.topic("depth")
    lost = f"{100 * share:.0f} % of the images sent at {rate:.1f} Hz are lost"
    if inputs.bytes < LARGE or not inputs.best_effort:
        return f"{lost}: the network or the machine is too busy; see `ros2 topic hz {topic}`"
    size = f"{inputs.bytes / 1e6:.1f} MB"
    return (
        f"{lost}: stock Fast DDS loses best effort messages of {size}, unless the driver of the camera has "
        f"FASTRTPS_DEFAULT_PROFILES_FILE={config_file('fastdds_large_images.xml')}; "
        f"let all publishers of {topic} offer reliable"
    )


def judge_mesh(inputs: Inputs, settings: Settings, now: float, now_ns: int) -> Verdict:
    """The status ``input mesh``.

    Args:
        now: steady time [s].
        now_ns: time of the node's clock [ns].
    """
    meshes = inputs.meshes
    store, sources = meshes.store, meshes.sources
    oldest, age = store.oldest(now_ns)
    used = {name: source for name, source in sources.items() if source.arrivals.count}
    values = {
        "topic": inputs.topic("mesh"),
        "frame": settings.mesh_frame or settings.fixed_frame or "-",
        "occluders": settings.occluders,
        "parts": len(store.parts),
        "triangles": store.triangle_count,
        "vertices": store.vertex_count,
        "age [s]": f"{age:.2f}" if oldest else "-",
        "oldest part": oldest or "-",
        "received": meshes.received,
        "refused": meshes.refused,
        "last refusal": next((s.refused.text for s in sources.values() if s.refused.recent(now)), "")
        or next((s.refused.text for s in sources.values() if s.refused.text), "-"),
        "replaced": store.updates["put"],
        "deformed": store.updates["deform"],
        "moved": store.updates["move"],
        "files": f"{len(settings.mesh_files)}" if settings.mesh_files else "-",
        "left out of files": "; ".join(meshes.left_out) or "-",
        "ignored markers": meshes.ignored_markers,
    }
    for name, source in used.items():
        rate = source.arrivals.rate(now)
        values[f"{name}: rate [Hz]"] = f"{rate:.1f}"
        values[f"{name}: received / refused"] = f"{source.arrivals.count} / {source.refused.count}"
        values[f"{name}: parsing, mean / 95 % / max [ms]"] = source.parsing.summary()
    for name, reason in meshes.layouts.reasons.items():
        values[f"layout of {name}"] = reason or "as expected"
    return *_mesh_verdict(inputs, settings, now), values


def _mesh_verdict(inputs: Inputs, settings: Settings, now: float) -> tuple[bytes, str]:
    meshes = inputs.meshes
    store = meshes.store
    mismatch = inputs.mismatch(*TOPICS)
    if mismatch:
        return ERROR, mismatch
    then = "masks are unknown" if store.lacking and not store.parts else "it casts no shadow"
    for name, source in meshes.sources.items():
        if source.refused.recent(now):
            kept = "the last good one stays" if meshes.in_force(name) else f"there is no earlier one and {then}"
            text = f"{source.refused.text}; {kept}; correct the publisher of {inputs.topic(name)}"
            return ERROR, f"{name} refused, {text}"
    if meshes.files:
        loaded = any(key.startswith(FILES) for key in store.parts)
        kept = "the others stay" if loaded else f"none is loaded and {then}"
        return ERROR, f"{meshes.files}; correct mesh.files, {kept}"
    slow = next(filter(None, meshes.layouts.reasons.values()), "")
    if slow:
        return WARN, f"{slow}; please report your ROS distribution"
    if not settings.uses_meshes:
        return OK, "occluders is depth: the depth image alone casts shadow"
    if not store.parts and not settings.uses_depth:
        topic = inputs.topic("mesh")
        if meshes.received == meshes.refused > 0:
            name, refused = next((name, s.refused) for name, s in meshes.sources.items() if s.refused.text)
            return WARN, (
                f"no mesh: all {meshes.refused} that came were refused and {then}, {refused.text}; "
                f"correct the publisher of {inputs.topic(name)}"
            )
        if meshes.received > 0:
            return WARN, f"the meshes have no triangles: every valid pixel is lit; see the publisher of {topic}"
        hint = f"publish shape_msgs/Mesh on {topic}, or remap mesh to its topic, or set mesh.files"
        return WARN, f"no mesh: every valid pixel is lit; {hint}"
    if len(store.parts) == 1:
        return OK, f"{store.triangle_count} triangles"
    return OK, f"{store.triangle_count} triangles in {len(store.parts)} parts"
