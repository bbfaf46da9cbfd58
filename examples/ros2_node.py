"""A ROS 2 node that measures what a source delivers, with the topics and stamps of an exported MCAP file.

    python3 ros2_node.py --ros-args -p source:="webcam:0?exposure_us=5000" -p camera:=camera.asdf

rclpy and rosidl_runtime_py come with ROS; chromaperture has to be installed where its Python finds it.
"""

import contextlib

import rclpy
from rclpy.node import Node
from rosidl_runtime_py import set_message_fields
from rosidl_runtime_py.utilities import get_message

import chromaperture as cap
from chromaperture.products.rectified import of_stream
from chromaperture.products.ros_messages import ros_messages


class DepthNode(Node):
    def __init__(self):
        super().__init__("chromaperture")
        self.outputs = {}

    def run(self):
        path, text = (self.declare_parameter(name, "").value for name in ("camera", "source"))
        camera = cap.load_camera(path, quality="real-time")
        with cap.open_source(text, camera_encoding=camera.calibration.sensor.encoding) as source:
            camera, frames = of_stream(camera, source)
            to_view = cap.undistorter(camera)
            for frame in frames:
                if not rclpy.ok():
                    break
                try:
                    view = to_view(camera.measure(frame.image), frame.time_s, frame.index)
                except cap.InputError as error:  # of one frame, such as a dark one
                    self.get_logger().warning(f"frame {frame.index} is left out: {error}")
                    continue
                self.publish(ros_messages(view, camera_matrix=camera.calibration.lens.camera_matrix))

    def publish(self, messages):
        for topic, (kind, fields) in messages.items():
            message = get_message(kind)()
            set_message_fields(message, fields)
            if topic not in self.outputs:
                self.outputs[topic] = self.create_publisher(type(message), topic, 1)
            self.outputs[topic].publish(message)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt):
        DepthNode().run()
    rclpy.try_shutdown()
