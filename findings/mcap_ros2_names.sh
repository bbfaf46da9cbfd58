#!/usr/bin/env bash
# mcap-ros2-support: a CameraInfo given as a dict in which a field is misspelt, one is missing and a matrix is too short.
#
# Expected: an error that names the field: the writer has the message's definition.
# Seen with mcap-ros2-support 0.6.0: a field of another name is left out, what is missing or None is written as zeros, a
# k of five numbers is filled up with zeros, and 3.7 in a field of uint32 becomes 3, without a word: ROS takes such a
# camera for uncalibrated. Only a number that the type cannot hold raises.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q mcap==1.6.0 mcap-ros2-support==0.6.0
"$folder/venv/bin/python" - <<'PYTHON'
import io

from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer

DEFINITION = "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
MATRIX = [900.0, 0.0, 320.0, 0.0, 900.0, 240.0, 0.0, 0.0, 1.0]
GOOD = {"height": 480, "width": 640, "distortion_model": "plumb_bob", "d": [0.0] * 5, "k": MATRIX}


def again(**changed):
    file = io.BytesIO()
    writer = Writer(file)
    schema = writer.register_msgdef("test_msgs/msg/Camera", DEFINITION)
    message = {name: value for name, value in (GOOD | changed).items() if value != "missing"}
    writer.write_message(topic="/camera", schema=schema, message=message, log_time=1, publish_time=1)
    writer.finish()
    file.seek(0)
    (read,) = read_ros2_messages(file)
    return read.ros_msg


assert list(again().k) == MATRIX, "a complete message does not come back"
cases = {
    "K for k": again(k="missing", K=MATRIX), "no width": again(width="missing"), "width None": again(width=None),
    "k of five": again(k=MATRIX[:5]), "width 3.7": again(width=3.7),
}
for name, seen in cases.items():
    print(f"{name}: width {seen.width}, k {list(seen.k)}")
assert list(cases["K for k"].k) == [0.0] * 9, "a misspelt field is no longer zeros"
assert cases["no width"].width == cases["width None"].width == 0, "a missing field is no longer 0"
assert list(cases["k of five"].k) == MATRIX[:5] + [0.0] * 4, "a short array is no longer filled up"
assert cases["width 3.7"].width == 3, "3.7 is no longer cut"
try:
    again(width=-3)
except Exception as error:
    print(f"width -3: {type(error).__name__}: {error}")
else:
    raise AssertionError("-3 is taken for a uint32 now")
PYTHON
