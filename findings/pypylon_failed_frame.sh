#!/usr/bin/env bash
# pypylon's emulated camera with a frame that fails on the way (ForceFailedBuffer): what tells that it failed?
#
# Expected: an error code that is not 0, and no picture.
# Seen with pypylon 26.9 (emulator 12.4.2): ErrorCode is 0, and .Array is a picture of the full size without an exception,
# though a tenth of its bytes arrived. Only GrabSucceeded() tells.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 pypylon==26.9
PYLON_CAMEMU=1 "$folder/venv/bin/python" - <<'PYTHON'
from pypylon import pylon

camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateFirstDevice())
camera.Open()
camera.Width.Value, camera.Height.Value = 128, 96
camera.ForceFailedBufferCount.Value = 1
camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
camera.ForceFailedBuffer.Execute()
failed = None
for _ in range(20):
    result = camera.RetrieveResult(1000)
    if not result.GrabSucceeded():
        failed = result.ErrorCode, result.ErrorDescription, result.PayloadSize, result.Array.shape
    result.Release()
camera.Close()
print("error code, description, bytes of 12288, shape of .Array:", failed)
assert failed is not None, "no frame failed"
assert failed[0] == 0, "a failed frame now has an error code"
assert failed[2] < 128 * 96 and failed[3] == (96, 128), "a failed frame no longer gives a whole picture"
PYTHON
