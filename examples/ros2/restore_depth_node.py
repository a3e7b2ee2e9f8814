"""A ROS 2 node that restores the depth of a camera while it runs.

    pip install 'std-toolkit[restore]'     # in the Python of the ROS 2 installation
    python examples/ros2/restore_depth_node.py --ros-args \
        -r color:=/camera/camera/color/image_raw \
        -r depth:=/camera/camera/aligned_depth_to_color/image_raw \
        -r camera_info:=/camera/camera/color/camera_info

It subscribes to `color` (rgb8 or bgr8), `depth` (16UC1 in millimetres or 32FC1 in metres, aligned
to colour) and `camera_info`, and publishes `restored/depth` (32FC1, metres) and
`restored/confidence` (32FC1) with the stamp and frame of the depth image. It drops frames while it
is busy.

The tests compile this file and try its conversions; they have no ROS 2 to run the node with.
"""

from __future__ import annotations

from typing import Any

import numpy as np

DEPTH_SCALE = 0.001  # metres per unit of 16UC1 (REP 118)


def color_of(message: Any) -> np.ndarray:
    """(H, W, 3) uint8 RGB of a sensor_msgs/Image."""
    if message.encoding not in ("rgb8", "bgr8"):
        raise ValueError(f"colour must be rgb8 or bgr8, not {message.encoding}")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return image if message.encoding == "rgb8" else image[..., ::-1]


def depth_of(message: Any) -> np.ndarray:
    """(H, W) float32 metres of a sensor_msgs/Image."""
    kinds = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
    if message.encoding not in kinds:
        raise ValueError(f"depth must be 16UC1 or 32FC1, not {message.encoding}")
    kind = np.dtype((">" if message.is_bigendian else "<") + kinds[message.encoding])
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    depth = np.ascontiguousarray(rows[:, : kind.itemsize * message.width]).view(kind)
    scale = 1.0 if message.encoding == "32FC1" else DEPTH_SCALE
    return depth.astype(np.float32) * np.float32(scale)


def fill_message(message: Any, image: np.ndarray, header: Any) -> Any:
    """Fill a sensor_msgs/Image of encoding 32FC1."""
    message.header, message.encoding, message.is_bigendian = header, "32FC1", 0
    message.height, message.width = image.shape
    message.step = 4 * image.shape[1]
    message.data = np.ascontiguousarray(image, "<f4").tobytes()
    return message


def main() -> None:
    import message_filters
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo, Image

    from benchmark import Restorer

    rclpy.init()
    node = Node("restore_depth")
    method = node.declare_parameter("method", "swindrnet").value
    restorer = Restorer.load(method)
    depth_topic = node.create_publisher(Image, "restored/depth", qos_profile_sensor_data)
    trust_topic = node.create_publisher(Image, "restored/confidence", qos_profile_sensor_data)

    def restore(color: Any, depth: Any, info: Any) -> None:
        K = np.reshape(info.k, (3, 3))
        found = restorer.restore(color_of(color), depth_of(depth), K)
        depth_topic.publish(fill_message(Image(), found.depth, depth.header))
        if found.confidence is not None:
            trust_topic.publish(fill_message(Image(), found.confidence, depth.header))

    topics = [
        message_filters.Subscriber(node, kind, name, qos_profile=qos_profile_sensor_data)
        for kind, name in ((Image, "color"), (Image, "depth"), (CameraInfo, "camera_info"))
    ]
    # A queue of one: what arrives while a frame is restored is dropped, the newest is kept.
    together = message_filters.ApproximateTimeSynchronizer(topics, queue_size=1, slop=0.02)
    together.registerCallback(restore)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
