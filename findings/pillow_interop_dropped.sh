#!/usr/bin/env bash
# Pillow's Image.Exif with an interoperability directory, where cameras that are set to Adobe RGB say so (R03).
#
# Expected: what is put into get_ifd(IFD.Interop) is written, as what is put into get_ifd(IFD.Exif) and get_ifd(IFD.GPSInfo).
# Seen with Pillow 13.0.0: Exif and GPS are there when the bytes are read again, Interop is not, without a word: it is
# written only where the Exif directory names it, as get_ifd(IFD.Exif)[IFD.Interop] = {1: "R03"} or in a file that had one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pillow==13.0.0
"$folder/venv/bin/python" - <<'PYTHON'
from PIL import Image
from PIL.ExifTags import IFD


def again(exif):
    read = Image.Exif()
    read.load(exif.tobytes())
    return [dict(read.get_ifd(directory)) for directory in (IFD.Exif, IFD.GPSInfo, IFD.Interop)]


exif = Image.Exif()
exif.get_ifd(IFD.Exif)[0xA001] = 0xFFFF
exif.get_ifd(IFD.GPSInfo)[1] = "N"
exif.get_ifd(IFD.Interop)[1] = "R03"
shooting, place, interop = again(exif)
print(f"Exif {shooting}, GPS {place}, Interop {interop}")
assert shooting == {0xA001: 0xFFFF} and place == {1: "N"}, "Exif or GPS is not written as it was given"
assert interop == {}, "Interop is written now"

exif = Image.Exif()
exif.get_ifd(IFD.Exif)[IFD.Interop] = {1: "R03"}
assert again(exif)[2] == {1: "R03"}, "Interop inside of Exif is no longer written"
PYTHON
