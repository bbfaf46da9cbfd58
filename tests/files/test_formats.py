"""Files for other programs, each read by a program or library that is not ours."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import shutil
import struct
import subprocess
import zipfile
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import chromaperture as cap
from chromaperture.files.depth_exr import read_exr, write_exr
from chromaperture.files.depth_photo import dynamic_depth_jpeg, encode_depth, gdepth_jpeg, with_xmp
from chromaperture.files.textured_mesh import glb_bytes, textured_mesh
from chromaperture.products.posed_sequence import read_trajectory, write_posed
from chromaperture.products.rectified import View
from chromaperture.system.errors import InputError

MATRIX = np.array([[500.0, 0, 40.5], [0, 505.0, 29.0], [0, 0, 1]])
SAMPLE = "still_life_cy_halves"


def scene(rng, height=60, width=90):
    """A slanted wall with a step and unknown pixels, and a picture of it; z in mm from the pupil."""
    z = np.linspace(900, 2400, width, dtype=np.float32) * np.ones((height, 1), np.float32)
    z[20:40, 30:50] = 700
    z[:5, :7] = np.nan
    color = cv2.GaussianBlur(rng.integers(0, 256, (height, width, 3)).astype(np.uint8), (0, 0), 2)
    confidence = rng.uniform(0, 1, (height, width)).astype(np.float32)
    return z, color, confidence


def exiftool(path, *options):
    """What ExifTool reads of a file; JSON, or the bytes of one tag."""
    if shutil.which("exiftool") is None:
        pytest.skip("ExifTool (Debian: libimage-exiftool-perl) is not installed: photographs with depth are NOT tested")
    done = subprocess.run(["exiftool", *options, path], capture_output=True, check=True, timeout=60)
    assert not done.stderr, done.stderr
    return done.stdout


def decoded(levels, near, far, form):
    """Depth by the formulas of Google's specification."""
    d = levels.astype(np.float64) / 65535
    return far * near / (far - d * (far - near)) if form == "RangeInverse" else near + d * (far - near)


# ---- photographs with depth inside


@pytest.mark.extra("readers", "trimesh")  # where the programs that read files are installed, too
@pytest.mark.parametrize("form", ["inverse", "linear"])
def test_gdepth_is_read_by_exiftool(tmp_path, rng, form):
    z, color, confidence = scene(rng, 300, 400)  # more than a segment holds
    photo = tmp_path / "a.jpg"
    photo.write_bytes(gdepth_jpeg(color, encode_depth(z, confidence, form=form)))
    (tags,) = json.loads(exiftool(photo, "-j", "-G1", "-n"))
    assert not any("Warning" in tag or "Error" in tag for tag in tags), tags
    assert tags["XMP-GDepth:Units"] == "mm"
    assert tags["XMP-GDepth:MeasureType"] == "OpticalAxis"
    assert tags["XMP-GDepth:Format"] == {"inverse": "RangeInverse", "linear": "RangeLinear"}[form]
    assert (tags["XMP-GDepth:ImageWidth"], tags["XMP-GDepth:ImageHeight"]) == (400, 300)
    near, far = tags["XMP-GDepth:Near"], tags["XMP-GDepth:Far"]
    assert (near, far) == (pytest.approx(700), pytest.approx(2400))
    levels = cv2.imdecode(np.frombuffer(exiftool(photo, "-b", "-XMP-GDepth:DepthImage"), np.uint8), -1)
    sure = cv2.imdecode(np.frombuffer(exiftool(photo, "-b", "-XMP-GDepth:Confidence"), np.uint8), -1)
    known = np.isfinite(z)
    found = decoded(levels, near, far, tags["XMP-GDepth:Format"])
    step = far**2 / 65535 * (1 / near - 1 / far) if form == "inverse" else (far - near) / 65535  # mm, at the far end
    np.testing.assert_allclose(found[known], z[known], atol=0.51 * step + 1e-3)
    assert (sure[~known] == 0).all()
    np.testing.assert_allclose((sure[known] - 1) / 254, confidence[known], atol=0.51 / 254)
    assert np.isfinite(found).all()
    assert found[0, 0] == pytest.approx(found[5, 0])  # of the nearest known pixel
    with Image.open(photo) as picture:
        np.testing.assert_allclose(np.asarray(picture, int), color.astype(int), atol=12)  # JPEG


@pytest.mark.extra("readers", "trimesh")  # where the programs that read files are installed, too
def test_a_small_depth_map_needs_no_extended_metadata(tmp_path, rng):
    z, color, confidence = scene(rng, 20, 60)
    data = gdepth_jpeg(color[:20], encode_depth(z[:20], confidence[:20]))
    assert b"http://ns.adobe.com/xmp/extension/" not in data
    (tmp_path / "a.jpg").write_bytes(data)
    (tags,) = json.loads(exiftool(tmp_path / "a.jpg", "-j", "-G1"))
    assert "XMP-xmpNote:HasExtendedXMP" not in tags
    assert "XMP-GDepth:DepthImage" in tags


def segments(data):
    """The segments of a JPEG file up to its picture: marker and content."""
    at = 2
    while data[at : at + 2] != b"\xff\xda":
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        yield data[at + 1], data[at + 4 : at + 2 + length]
        at += 2 + length


def test_extended_metadata_are_split_as_adobe_says(rng):
    # A parser of its own, by the specification alone: pieces in order, MD5 of the whole as their name.
    z, color, confidence = scene(rng, 300, 400)
    encoded = encode_depth(z, confidence)
    parts = list(segments(gdepth_jpeg(color, encoded)))
    standard = [c for m, c in parts if m == 0xE1 and c.startswith(b"http://ns.adobe.com/xap/1.0/\0")]
    extended = [c[35:] for m, c in parts if m == 0xE1 and c.startswith(b"http://ns.adobe.com/xmp/extension/\0")]
    assert len(standard) == 1
    assert len(extended) > 1
    whole = b""
    for piece in extended:
        guid, (length, offset) = piece[:32], struct.unpack(">II", piece[32:40])
        assert offset == len(whole)
        whole += piece[40:]
    assert length == len(whole)
    assert hashlib.md5(whole).hexdigest().upper().encode() == guid
    assert b"<xmpNote:HasExtendedXMP>" + guid in standard[0]
    gdepth = "{http://ns.google.com/photos/1.0/depthmap/}"
    png = base64.b64decode(ElementTree.fromstring(whole).find(f".//{gdepth}Data").text)
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), -1), encoded.levels)


def test_exif_stays_before_the_metadata(rng):
    file = io.BytesIO()
    exif = Image.Exif()
    exif[271] = "maker"
    Image.fromarray(scene(rng)[1]).save(file, "JPEG", exif=exif)
    data = with_xmp(file.getvalue(), {("http://ns.adobe.com/xap/1.0/", "xmp", "Label"): "a < b & c"})
    assert [c[:4] for m, c in segments(data) if m in (0xE0, 0xE1)] in ([b"Exif", b"http"], [b"JFIF", b"Exif", b"http"])
    image = Image.open(io.BytesIO(data))
    assert image.getexif()[271] == "maker"
    assert "a &lt; b &amp; c" in image.info["xmp"].decode()
    with pytest.raises(InputError, match="no JPEG"):
        with_xmp(b"PNG", {})


@pytest.mark.extra("readers", "trimesh")  # where the programs that read files are installed, too
def test_dynamic_depth_is_read_by_exiftool(tmp_path, rng):
    z, color, confidence = scene(rng, 300, 400)
    photo, encoded = tmp_path / "a.jpg", encode_depth(z, confidence)
    photo.write_bytes(dynamic_depth_jpeg(color, encoded, camera_matrix=MATRIX))
    (tags,) = json.loads(exiftool(photo, "-j", "-G1", "-n", "-struct"))
    assert not any("Warning" in tag or "Error" in tag for tag in tags), tags
    items = [entry["Item"] for entry in tags["XMP-Device:Container"]["Directory"]]
    assert [item["Mime"] for item in items] == ["image/jpeg", "image/png", "image/png"]
    assert items[0]["Length"] == 0
    (camera,) = (entry.get("Camera", entry) for entry in tags["XMP-Device:Cameras"])
    depth_map, model = camera["DepthMap"], camera["ImagingModel"]
    assert (depth_map["Units"], depth_map["Format"], depth_map["ItemSemantic"]) == ("Meters", "RangeInverse", "Depth")
    assert (model["FocalLengthX"], model["PrincipalPointY"]) == (500.0, 29.0)
    # The pictures lie behind the first in the order of the directory, the last one up to the end of the file.
    data = photo.read_bytes()
    at = len(data) - sum(int(item["Length"]) for item in items)
    assert data[at - 2 : at] == b"\xff\xd9"  # the end of the photograph
    pictures = {}
    for item in items[1:]:
        picture = np.frombuffer(data, np.uint8, int(item["Length"]), at)
        pictures[item["DataURI"]] = cv2.imdecode(picture, -1)
        at += int(item["Length"])
    metres = decoded(pictures[depth_map["DepthURI"]], depth_map["Near"], depth_map["Far"], depth_map["Format"])
    known = np.isfinite(z)
    np.testing.assert_allclose(1000 * metres[known], z[known], atol=0.1)  # a step at 2.4 m is 0.09 mm
    assert (pictures[depth_map["ConfidenceURI"]] == encoded.confidence).all()
    with Image.open(photo) as picture:
        assert picture.size == (400, 300)


def test_depth_that_cannot_be_encoded_is_refused(rng):
    z, _, confidence = scene(rng)
    with pytest.raises(InputError, match="no pixel"):
        encode_depth(np.full_like(z, np.nan), confidence)
    with pytest.raises(InputError, match="inverse or linear"):
        encode_depth(z, confidence, form="log")
    flat = encode_depth(np.full((4, 5), 1000, np.float32), np.ones((4, 5)))
    assert decoded(flat.levels, flat.near_mm, flat.far_mm, "RangeInverse") == pytest.approx(1000, abs=1e-3)


# ---- surfaces


def test_surfaces_end_at_edges_and_lie_on_their_rays(rng):
    z, color, _ = scene(rng)
    distortion = np.array([-0.1, 0.02, 0.001, -0.001, 0.0])
    mesh = textured_mesh(z, color, camera_matrix=MATRIX, distortion=distortion)
    pixels, _ = cv2.projectPoints(mesh.vertices_mm.astype(float), np.zeros(3), np.zeros(3), MATRIX, distortion)
    np.testing.assert_allclose(mesh.texture * (90, 60) - 0.5, pixels[:, 0], atol=2e-3)  # float32
    corners = mesh.vertices_mm[mesh.triangles]
    assert (np.ptp(corners[..., 2], axis=1) < 0.04 * corners[..., 2].min(axis=1)).all()
    assert np.abs(corners[..., 2] - 700).min(axis=1).max() > 100  # the wall is there, too
    # Against the clock as the camera sees them, with y upwards.
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, i], :2] * (1, -1) / mesh.vertices_mm[mesh.triangles[:, i], 2:]
               for i in range(3))  # fmt: skip
    assert ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0).all()
    with pytest.raises(InputError, match="no surface"):
        textured_mesh(np.full((5, 5), np.nan), color[:5, :5], camera_matrix=MATRIX, distortion=np.zeros(5))


CHECK = """
const validator = require('gltf-validator'), fs = require('fs');
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r => console.log(JSON.stringify(r)));
"""


def require_gltf_validator():
    """Skip where node does not find Khronos's validator (npm: gltf-validator; NODE_PATH says where it is)."""
    command = ["node", "-e", "require('gltf-validator')"]
    if shutil.which("node") is None or subprocess.run(command, capture_output=True, check=False, timeout=60).returncode:
        pytest.skip("gltf-validator (npm) is not installed: Khronos's glTF validator was NOT run")


def surface(rng):
    z, color, _ = scene(rng)
    return textured_mesh(z, color, camera_matrix=MATRIX, distortion=np.zeros(5))


@pytest.mark.extra("readers", "trimesh")  # where the programs that read files are installed, too
def test_khronos_finds_no_fault_in_a_surface(tmp_path, rng):
    require_gltf_validator()
    mesh = surface(rng)
    (tmp_path / "a.glb").write_bytes(glb_bytes(mesh))
    command = ["node", "-e", CHECK, tmp_path / "a.glb"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    report = json.loads(done.stdout)
    assert (report["issues"]["numErrors"], report["issues"]["numWarnings"]) == (0, 0), report["issues"]
    assert report["info"]["totalTriangleCount"] == len(mesh.triangles)


@pytest.mark.extra("readers", "trimesh")
def test_a_surface_is_read_by_trimesh(tmp_path, rng):
    import trimesh

    mesh = surface(rng)
    (tmp_path / "a.glb").write_bytes(glb_bytes(mesh))
    read = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    np.testing.assert_allclose(read.vertices * 1000 * (1, -1, -1), mesh.vertices_mm, rtol=1e-6)
    np.testing.assert_array_equal(read.faces, mesh.triangles)
    np.testing.assert_allclose(read.visual.uv, mesh.texture * (1, -1) + (0, 1), atol=1e-6)  # trimesh: upwards
    assert read.visual.material.baseColorTexture.size == (90, 60)
    tree = json.loads((tmp_path / "a.glb").read_bytes()[20:].split(b"\0")[0].rsplit(b"}", 1)[0] + b"}")
    perspective = tree["cameras"][0]["perspective"]
    assert perspective["yfov"] == pytest.approx(2 * np.arctan(30 / 505))
    # Half the height over half the width of what is seen: tan of the angles.
    assert np.tan(perspective["yfov"] / 2) * perspective["aspectRatio"] == pytest.approx(45 / 500)


@pytest.mark.extra("usd", "pxr")
def test_usdz_is_a_package_with_camera_and_texture(tmp_path, rng):
    from pxr import Usd, UsdGeom, UsdShade

    from chromaperture.files.textured_mesh import write_usdz

    mesh = surface(rng)
    write_usdz(tmp_path / "a.usdz", mesh)
    with zipfile.ZipFile(tmp_path / "a.usdz") as package:  # the specification: not compressed, at multiples of 64 bytes
        for entry in package.infolist():
            assert entry.compress_type == zipfile.ZIP_STORED
            package.fp.seek(entry.header_offset + 26)
            name, extra = struct.unpack("<HH", package.fp.read(4))
            assert (entry.header_offset + 30 + name + extra) % 64 == 0
        (texture,) = (n for n in package.namelist() if n.endswith(".jpg"))
        assert Image.open(io.BytesIO(package.read(texture))).size == (90, 60)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdz"))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Y")
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/photograph/surface")).GetPointsAttr().Get())
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/photograph/camera")).GetCamera(Usd.TimeCode.Default())
    # USD's own projection puts every vertex where its pixel is, the off-axis principal point included.
    frustum = camera.frustum
    matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    clip = np.column_stack([points, np.ones(len(points))]) @ matrix
    across = (clip[:, :2] / clip[:, 3:] * (1, -1) + 1) / 2
    np.testing.assert_allclose(across * (90, 60), mesh.texture * (90, 60), atol=5e-3)
    bound, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/photograph/surface")).ComputeBoundMaterial()
    assert bound.GetPath() == "/photograph/material"


@pytest.mark.extra("exr", "OpenEXR")
def test_exr_holds_depth_error_bar_and_confidence(tmp_path, run):
    import OpenEXR

    image, camera = cap.sample_image(SAMPLE), cap.sample_camera(SAMPLE)
    names = "exr,exr-layers,depth,sigma"
    wanted = ("--out", tmp_path, "--write", names, "--quality=real-time", "-q")
    assert run("depth", image, "--camera", camera, *wanted).returncode == 0
    with OpenEXR.File(str(tmp_path / f"{SAMPLE}.exr"), separate_channels=True) as file:
        channels, header = {n: np.array(c.pixels) for n, c in file.channels().items()}, dict(file.header())
    assert set(channels) == {"R", "G", "B", "Z", "sigma_mm", "confidence"}
    depth = cv2.imread(str(tmp_path / f"{SAMPLE}.depth.tiff"), -1)
    sigma = cv2.imread(str(tmp_path / f"{SAMPLE}.sigma.tiff"), -1)
    np.testing.assert_allclose(channels["Z"] + header["sensor_to_pupil_mm"], depth, rtol=1e-6)
    np.testing.assert_array_equal(channels["sigma_mm"], sigma)
    assert header["focal_length_x_px"] == pytest.approx(1664.8, abs=0.1)
    # Blender 5.0 offers Combined, Depth, sigma_mm and confidence of these names; without Blender, the names alone.
    with OpenEXR.File(str(tmp_path / f"{SAMPLE}.layers.exr"), separate_channels=True) as file:
        layers = {n.removeprefix("V."): np.array(c.pixels) for n, c in file.channels().items()}
    plain = {"Combined.R": "R", "Combined.G": "G", "Combined.B": "B", "Depth.Z": "Z", "sigma_mm.V": "sigma_mm"}
    plain["confidence.V"] = "confidence"
    assert set(layers) == set(plain)
    for layer, name in plain.items():
        np.testing.assert_array_equal(layers[layer], channels[name])
    # Our own reader, for `view` and `compare`.
    for suffix in (".layers.exr", ".exr"):
        alone = shutil.copy(tmp_path / f"{SAMPLE}{suffix}", tmp_path / f"alone{suffix}")
        compared = run("compare", tmp_path / f"{SAMPLE}.depth.tiff", alone, "--json")
        assert json.loads(compared.stdout)["difference_mm"]["median_absolute"] < 1e-3
    assert run("view", alone, "--out", tmp_path / "page.html").returncode == 0
    assert "confidence" in (tmp_path / "page.html").read_text()
    (tmp_path / "bad.exr").write_bytes((tmp_path / "alone.exr").read_bytes()[:-1000])
    result = run("view", tmp_path / "bad.exr")
    assert (result.returncode, result.stderr.count("error: bad.exr is damaged")) == (2, 1)  # OpenEXR prints, too


@pytest.mark.extra("exr", "OpenEXR")
@pytest.mark.parametrize("view", [np.transpose, lambda a: a[10:50, 20:70], lambda a: a[::2, ::-1]])
def test_exr_holds_maps_that_are_views(tmp_path, rng, view):
    maps = [view(rng.uniform(1, 2, (60, 90)).astype(np.float32)) for _ in range(4)]
    write_exr(tmp_path / "a.exr", color=np.stack([maps[3]] * 3, axis=-1), depth_mm=maps[0], sigma_mm=maps[1],
              confidence=maps[2], camera_matrix=MATRIX, sensor_to_pupil_mm=0.0)  # fmt: skip
    for read, written in zip(read_exr(tmp_path / "a.exr"), maps, strict=False):
        np.testing.assert_array_equal(read, written)


def test_formats_come_only_where_they_are_named(tmp_path, run):
    image, camera = cap.sample_image(SAMPLE), cap.sample_camera(SAMPLE)
    names = "gdepth,dynamic-depth,glb"
    wanted = ("--out", tmp_path, "--write", names, "--quality=real-time", "-q")
    assert run("depth", image, "--camera", camera, *wanted).returncode == 0
    assert {p.name.removeprefix(SAMPLE) for p in tmp_path.iterdir()} == {".gdepth.jpg", ".dynamic-depth.jpg", ".glb"}
    options = ("--camera", camera, "--out", tmp_path / "x", "--write", names, "--quality=real-time")
    done = run("depth", image, *options, "--max-relative-sigma", "1e-9")
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1)
    assert "--max-relative-sigma" in done.stderr
    assert not list((tmp_path / "x").glob("*"))
    done = run("depth", image, "--design", "cy_halves", "--out", tmp_path / "x", "--write", "glb")
    assert done.returncode == 2
    assert "calibrated" in done.stderr


# ---- sequences with poses


def walk(rng):
    """Views of a wall, z = 1500 mm in the world, from three places; the second has no pose."""
    views, poses = [], {}
    for index, (x_mm, turn) in enumerate([(0, 0.0), (50, 0.05), (120, -0.1)]):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.02, turn, 0.01]))[0]
        pose[:3, 3] = x_mm, -20, 10
        v, u = np.mgrid[:60, :90]
        rays = np.stack([(u - 40.5) / 500, (v - 29) / 505, np.ones(u.shape)], axis=-1) @ pose[:3, :3].T
        z = ((1500 - pose[2, 3]) / rays[..., 2]).astype(np.float32)  # along the camera's axis, whose ray has z = 1
        z[:4] = np.nan
        color = rng.integers(0, 256, (60, 90, 3)).astype(np.uint8)
        views.append(View(color, z, 0.01 * z, 100 + index / 8, 7 + index))
        poses[7 + index] = pose
    del poses[8]
    return views, poses


@pytest.mark.extra("readers", "pycolmap")
def test_colmap_model_is_read_by_pycolmap(tmp_path, rng):
    import pycolmap

    views, poses = walk(rng)
    out = tmp_path / "colmap"
    assert write_posed(out, views, form="colmap", camera_matrix=MATRIX, poses=lambda frames: poses) == 2
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    assert (model.num_images(), model.num_cameras(), model.num_points3D()) == (2, 1, 4000)
    for image in model.images.values():
        stored = cv2.imread(str(out / "images" / image.name))[..., ::-1]
        index = {(v.color == stored).all(): v.index for v in views}[True]
        to_world = np.linalg.inv(np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]))
        np.testing.assert_allclose(to_world[:3, 3] * 1000, poses[index][:3, 3], atol=1e-5)
        np.testing.assert_allclose(to_world[:3, :3], poses[index][:3, :3], atol=1e-8)
        for point in image.points2D[::100]:
            world = model.points3D[point.point3D_id].xyz
            assert world[2] == pytest.approx(1.5, abs=2e-6)  # m; float32 depth
            np.testing.assert_allclose(image.project_point(world), point.xy, atol=1e-3)  # COLMAP's own camera
    assert sorted(p.name for p in (out / "depth_mm").iterdir()) == ["000000.png", "000002.png"]


def test_nerfstudio_transforms_place_the_wall(tmp_path, rng):
    # Nerfstudio itself is 3 GB with PyTorch: here its documented conventions, followed on their own.
    views, poses = walk(rng)
    out = tmp_path / "nerf"
    assert write_posed(out, views, form="nerfstudio", camera_matrix=MATRIX, poses=lambda frames: poses) == 2
    tree = json.loads((out / "transforms.json").read_text())
    assert (tree["w"], tree["h"], tree["camera_model"], len(tree["frames"])) == (90, 60, "OPENCV", 2)
    for frame in tree["frames"]:
        assert (out / frame["file_path"]).is_file()
        depth = cv2.imread(str(out / frame["depth_file_path"]), -1) * tree["depth_unit_scale_factor"]
        rows, columns = np.nonzero(depth)
        across, down = (columns + 0.5 - tree["cx"]) / tree["fl_x"], (rows + 0.5 - tree["cy"]) / tree["fl_y"]
        z = depth[rows, columns]
        opengl = np.stack([across * z, -down * z, -z, np.ones(len(z))])
        world = np.array(frame["transform_matrix"]) @ opengl
        np.testing.assert_allclose(world[2], 1.5, atol=6e-4)  # whole mm
    points = cap_points(out / tree["ply_file_path"])
    np.testing.assert_allclose(points[:, 2], 1.5, atol=2e-6)


def cap_points(path):
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    return np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "u1", 3)])["xyz"]


def test_open3d_folder(tmp_path, rng):
    views, _ = walk(rng)
    assert write_posed(tmp_path / "o", views, form="open3d", camera_matrix=MATRIX) == 3
    tree = json.loads((tmp_path / "o" / "camera_intrinsic.json").read_text())
    assert tree["intrinsic_matrix"] == [500, 0, 0, 0, 505, 0, 40.5, 29, 1]  # column by column
    assert [len(list((tmp_path / "o" / part).iterdir())) for part in ("color", "depth")] == [3, 3]


@pytest.mark.extra("reconstruct", "open3d")
def test_open3d_reads_its_folder(tmp_path, rng):
    import open3d

    views, _ = walk(rng)
    write_posed(tmp_path / "o", views, form="open3d", camera_matrix=MATRIX)
    lens = open3d.io.read_pinhole_camera_intrinsic(str(tmp_path / "o" / "camera_intrinsic.json"))
    np.testing.assert_array_equal(lens.intrinsic_matrix, MATRIX)
    color, depth = (open3d.io.read_image(str(tmp_path / "o" / part / "000000.png")) for part in ("color", "depth"))
    picture = open3d.geometry.RGBDImage.create_from_color_and_depth(color, depth, depth_trunc=5.0)
    np.testing.assert_allclose(np.asarray(picture.depth)[10:], views[0].z_mm[10:] / 1000, atol=6e-4)  # whole mm


@pytest.mark.extra("reconstruct", "open3d")
def test_open3d_fuses_its_folder(tmp_path, rng):
    import open3d
    from open3d.core import Tensor

    views, poses = walk(rng)
    write_posed(tmp_path / "o", views, form="open3d", camera_matrix=MATRIX)
    kinds = (open3d.core.float32,) * 3
    grid = open3d.t.geometry.VoxelBlockGrid(("tsdf", "weight", "color"), kinds, ((1,), (1,), (3,)), 0.01, 16, 1000)
    for number, index in ((0, 7), (2, 9)):
        names = (str(tmp_path / "o" / part / f"{number:06d}.png") for part in ("color", "depth"))
        color, depth = (open3d.t.io.read_image(name) for name in names)
        to_camera = np.linalg.inv(poses[index])
        to_camera[:3, 3] /= 1000
        where = (Tensor(MATRIX), Tensor(to_camera), 1000.0, 5.0)
        grid.integrate(grid.compute_unique_block_coordinates(depth, *where), depth, color, *where)
    points = grid.extract_triangle_mesh(0).vertex.positions.numpy()
    assert len(points) > 300  # 0.4 m2 of wall in voxels of 10 mm
    np.testing.assert_allclose(points[:, 2], 1.5, atol=1.5e-3)  # whole mm, slanted views


def turned(degrees, x_m):
    """A line of a trajectory without its time: turned about y, moved along x."""
    x, y, z, w = Rotation.from_euler("y", degrees, degrees=True).as_quat()
    return f"{x_m} 0 0 {x} {y} {z} {w}"


def test_a_frame_between_two_poses_lies_between_them(tmp_path):
    path, said = tmp_path / "t.txt", []
    poses_of = [(0.0, turned(0, 0)), (0.03, turned(30, 0.3)), (1.0, turned(170, 1)), (1.01, turned(-170, 1))]
    path.write_text("".join(f"{time} {pose}\n" for time, pose in reversed(poses_of)))
    frames = [(0, 0.0), (1, 0.02), (2, 0.045), (3, 0.051), (4, 0.5), (5, 0.995), (6, 1.005), (7, 1.031), (8, -0.02)]
    found = read_trajectory(path, listener=said.append)(frames)
    assert list(found) == [0, 1, 2, 5, 6, 8]
    # Nearest where one side alone is within the limit, of 0.02 s; else between, the short way about.
    angles = {0: 0, 1: 20, 2: 30, 5: 170, 6: 180, 8: 0}
    places = {0: 0, 1: 200, 2: 300, 5: 1000, 6: 1000, 8: 0}
    for index, pose in found.items():
        turn = Rotation.from_euler("y", angles[index], degrees=True).as_matrix()
        np.testing.assert_allclose(pose[:3, :3], turn, atol=1e-9)
        np.testing.assert_allclose(pose[:3, 3], (places[index], 0, 0), atol=1e-6)
    (line,) = said
    assert line == "3 of 9 frames have no pose within 0.02 s in t.txt: left out"
    with pytest.raises(InputError, match=r"poses from 0\.000 to 1\.010 s, frames from 9\.000 to 9\.000 s"):
        read_trajectory(path)([(0, 9.0)])
    assert len(read_trajectory(path, limit_s=0)(frames)) == 1
    assert len(read_trajectory(path, limit_s=np.inf)(frames)) == 9
    for limit_s in (-0.1, np.nan):
        with pytest.raises(InputError, match="--trajectory-limit-s"):
            read_trajectory(path, limit_s=limit_s)
    path.write_text("# nothing\n")
    with pytest.raises(InputError, match="holds no pose"):
        read_trajectory(path)


def test_trajectories_are_read_and_bad_lines_named(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text("# time\n1.5 0.1 0.2 0.3 0 0 0.7071068 0.7071068\n# submap 1: a new origin\n2.5 0 0 0 0 0 0 1\n")
    found = read_trajectory(path)([(3, 1.5), (4, 2.5)])
    assert list(found) == [3]
    np.testing.assert_allclose(found[3], [[0, -1, 0, 100], [1, 0, 0, 200], [0, 0, 1, 300], [0, 0, 0, 1]], atol=1e-6)
    extreme = ("1 1e300 0 0 0 0 0 1", "1 0 0 0 0 0 0 1e-200")
    for bad in ("1 2 3", "1 0 0 0 0 0 0 0", "1 0 0 nan 0 0 0 1", *extreme, "a 0 0 0 0 0 0 1"):
        path.write_text(f"{bad}\n")
        with pytest.raises(InputError, match="line 1"):
            read_trajectory(path)


def test_export_with_a_trajectory(tmp_path, run):
    image, camera = cap.sample_image(SAMPLE), cap.sample_camera(SAMPLE)
    (tmp_path / "t.txt").write_text("0 0 0 0 0 0 0 1\n")
    out = tmp_path / "walk"
    options = ("--camera", camera, "--quality=real-time")
    done = run("export", image, out, *options, "--format", "nerfstudio", "--trajectory", tmp_path / "t.txt")
    assert done.returncode == 0, done.stderr
    assert len(json.loads((out / "transforms.json").read_text())["frames"]) == 1
    (tmp_path / "t.txt").write_text("5 0 0 0 0 0 0 1\n")
    for words in (("--format", "colmap", "--trajectory", tmp_path / "t.txt"), ("--format", "kitti"),
                  ("--format", "tum", "--trajectory", tmp_path / "t.txt"), ("--format", "open3d")):  # fmt: skip
        target = out if words == ("--format", "open3d") else tmp_path / "new"  # it exists
        done = run("export", image, target, *options, "-q", *words)
        assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1), done.stderr
    assert not (tmp_path / "new").exists()
    wide = ("--format", "colmap", "--trajectory", tmp_path / "t.txt", "--trajectory-limit-s", 5)
    assert run("export", image, tmp_path / "far", *options, "-q", *wide).returncode == 0
    assert "VoxelBlockGrid" in run("export", image, tmp_path / "o3d", *options, "--format", "open3d").stdout
