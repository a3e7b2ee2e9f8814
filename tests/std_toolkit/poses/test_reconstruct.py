"""What is left of a model after its adjustment."""

from __future__ import annotations

import pycolmap

from std_toolkit.poses.mapping import unregister_unseen


def test_an_image_that_lost_its_points_has_no_pose() -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig = 1, 1
    options.num_frames_per_rig, options.num_points3D = 4, 60
    pycolmap.set_random_seed(0)
    model = pycolmap.synthesize_dataset(options)
    image = model.image(sorted(model.reg_image_ids())[2])
    for index in image.get_observation_point2D_idxs()[:-5]:
        model.delete_observation(image.image_id, index)
    assert 0 < image.num_points3D < 20
    unregister_unseen(model, min_points=20)
    assert not model.image(image.image_id).has_pose
    assert model.num_reg_images() == 3
