#!/usr/bin/env bash
# rosbags: a CameraInfo whose camera matrix is a NumPy array of integers, as np.array([[900, 0, 320], ...]) makes it.
#
# Expected: the field is float64[9]: the numbers are converted, or an error names the field.
# Seen with rosbags 0.11.9: serialize_cdr writes the eight bytes of every int64 as they are, so that 900 is read again
# as 4.4e-321, without a word, and so it does with float64 of the other byte order. float32 raises ValueError, since its
# elements have another size, a list AttributeError.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 rosbags==0.11.9
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from rosbags.typesys import Stores, get_typestore

NAME = "sensor_msgs/msg/CameraInfo"
store = get_typestore(Stores.ROS2_JAZZY)
matrix = np.array([[900, 0, 320], [0, 900, 240], [0, 0, 1]])
projection = np.column_stack([matrix, np.zeros(3)]).astype(float)


def again(k):
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](sec=1, nanosec=0), frame_id="camera")
    whole = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    message = types[NAME](
        header=header, height=480, width=640, distortion_model="plumb_bob", d=np.zeros(5), k=k, r=np.eye(3).ravel(),
        p=projection.ravel(), binning_x=0, binning_y=0, roi=whole,
    )
    return store.deserialize_cdr(store.serialize_cdr(message, NAME), NAME).k


for kind in ("float64", "int64", ">f8"):
    print(f"k of type {kind}: {again(matrix.ravel().astype(kind))[:3]}")
assert np.array_equal(again(matrix.ravel().astype(float)), matrix.ravel()), "float64 is not written as it is"
for values in (matrix.ravel(), matrix.ravel().astype(">f8")):
    assert np.array_equal(again(values), values.view("<f8")), "the bytes are no longer written as they are"
for values, error in ((matrix.ravel().astype(np.float32), ValueError), (matrix.ravel().tolist(), AttributeError)):
    try:
        again(values)
    except error as raised:
        print(f"k of type {getattr(values, 'dtype', 'list')}: {type(raised).__name__}: {raised}")
    else:
        raise AssertionError(f"{getattr(values, 'dtype', 'list')} is taken now")
PYTHON
