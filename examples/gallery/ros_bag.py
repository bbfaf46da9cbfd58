"""
ROS bag in, ROS bag out
=======================

A bag (MCAP) of colour pictures as a robot recorded them goes in; a bag with depth, error bar and aligned colour comes
out, in the encodings of REP 118, which RViz and ``depth_image_proc`` read. Needs the extra ``ros`` and no ROS.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer

import chromaperture as cap
from chromaperture.color.color_maps import DISTANCE

folder = Path(tempfile.mkdtemp())
camera, photograph = cap.open_sample("still_life_cy_halves", quality="real-time")
sensor = camera.calibration.sensor

# %%
# A robot's bag is needed first. Here it has two pictures of 16 bits a channel, the counts of the sensor.

IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
counts = np.rint(photograph * (sensor.white_level - sensor.black_level) + sensor.black_level).astype("<u2")
with (folder / "robot.mcap").open("wb") as file:
    writer = Writer(file)
    schema = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE)
    for index in range(2):
        stamp = {"sec": index, "nanosec": 0}
        picture = {
            "header": {"stamp": stamp, "frame_id": "camera"},
            "height": counts.shape[0],
            "width": counts.shape[1],
            "encoding": "rgb16",
            "is_bigendian": 0,
            "step": counts.strides[0],
            "data": counts.tobytes(),
        }
        writer.write_message("/camera/image_raw", schema, picture, log_time=index * 10**9, publish_time=index * 10**9)
    writer.finish()

# %%
# In: every picture becomes linear light between the camera's black and white level, and is measured. Out: what
# `undistorter` makes of it, one frame at a time.

to_view = cap.undistorter(camera)


def views(bag: Path):
    """Measure the pictures of a bag."""
    for index, message in enumerate(read_ros2_messages(bag, topics=["/camera/image_raw"])):
        picture = message.ros_msg
        if picture.encoding != "rgb16":
            raise SystemExit(f"expected rgb16, got {picture.encoding}: convert it, or read it as your camera writes it")
        counts = np.frombuffer(picture.data, "<u2").reshape(picture.height, picture.width, 3)
        light = (counts.astype(np.float32) - sensor.black_level) / (sensor.white_level - sensor.black_level)
        time_s = picture.header.stamp.sec + picture.header.stamp.nanosec / 1e9
        yield to_view(camera.measure(light), time_s, index)


written = cap.write_mcap(
    folder / "depth.mcap", views(folder / "robot.mcap"), camera_matrix=camera.calibration.lens.camera_matrix
)
print(f"{written} frames, {(folder / 'depth.mcap').stat().st_size / 1e6:.1f} MB")

# %%
# Read back as a robot would.

depth = next(iter(read_ros2_messages(folder / "depth.mcap", topics=["/camera/depth/image_rect"]))).ros_msg
z_mm = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width).astype(float)
z_mm[z_mm == 0] = np.nan
figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
figure.colorbar(axes.imshow(z_mm, cmap=DISTANCE), label=f"mm ({depth.encoding})")
axes.axis("off")
