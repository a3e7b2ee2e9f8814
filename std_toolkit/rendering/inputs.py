"""What ground truth is made from besides poses: camera, meshes, scale of the depth."""

from __future__ import annotations

from std_toolkit.rendering.placements import frame_placements
from std_toolkit.scene.provenance import digest_of
from std_toolkit.scene.scene import Scene


def frame_inputs(scene: Scene, frame_id: int) -> str:
    """Digest of the inputs; it tells stale ground truth, whatever toolkit or option made it."""
    camera = scene.camera(scene.frame(frame_id))
    meshes = {
        str(i): scene.mesh_digest(scene.objects.object(i).model)
        for i in frame_placements(scene, frame_id)
    }
    return digest_of(
        [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy],
        list(camera.distortion),
        meshes,
        [scene.info.depth_scale, scene.info.depth_correction],
        versioned=False,
    )
