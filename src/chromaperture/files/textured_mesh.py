"""A depth map as a surface with the photograph on it, as GLB (Khronos, glTF 2.0, 2021) and USDZ (extra ``usd``)."""

from __future__ import annotations

import io
import json
import math
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from chromaperture.system.errors import InputError, MissingDependencyError

# Relative step of distance between corners of a triangle at which the surface ends: that from which a pixel is a flying
# one in the reconstruction.
_EDGE_JUMP = 0.04
_MOST_VERTICES = 1_000_000  # chosen by hand: 24 megapixels become every fifth column and row, 40 MB of file


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles in the camera frame: mm, origin at the entrance pupil, x right, y down, z forward."""

    vertices_mm: np.ndarray  # (N, 3) float32
    texture: np.ndarray  # (N, 2) float32: place in the picture, 0 to 1 from its left and its upper edge
    triangles: np.ndarray  # (M, 3) uint32: seen from the camera, corners go round against the clock
    picture: np.ndarray  # (H, W, 3) uint8: sRGB
    camera_matrix: np.ndarray  # (3, 3) float, px: of the pinhole that saw it, distortion removed


def textured_mesh(
    z_mm: np.ndarray, picture: np.ndarray, *, camera_matrix: np.ndarray, distortion: np.ndarray
) -> TexturedMesh:
    """Join neighbouring pixels to triangles where no edge of depth is between them, along the lens's rays."""
    height, width = z_mm.shape
    step = 1
    while -(-height // step) * -(-width // step) > _MOST_VERTICES:
        step += 1
    rows, columns = np.arange(0, height, step), np.arange(0, width, step)
    z = z_mm[::step, ::step].astype(np.float64)
    known = np.isfinite(z) & (z > 0)
    number = np.full(z.shape, -1, np.int64)
    corners = [(slice(a, -1 if a == 0 else None), slice(b, -1 if b == 0 else None)) for a, b in
               ((0, 0), (0, 1), (1, 0), (1, 1))]  # fmt: skip
    kept = [np.zeros(tuple(max(n - 1, 0) for n in z.shape), bool) for _ in range(2)]
    order = ((0, 2, 1), (1, 2, 3))  # against the clock for the camera, for which y goes down
    for keep, triangle in zip(kept, order, strict=True):
        depths = np.stack([z[corners[i]] for i in triangle])
        with np.errstate(invalid="ignore"):
            near, far = depths.min(axis=0), depths.max(axis=0)
            keep[:] = np.all([known[corners[i]] for i in triangle], axis=0) & (far - near < _EDGE_JUMP * near)
    used = np.zeros(z.shape, bool)
    for keep, triangle in zip(kept, order, strict=True):
        for i in triangle:
            used[corners[i]] |= keep
    if not used.any():
        raise InputError("no surface was found: too few neighbouring pixels are known; widen --max-relative-sigma")
    number[used] = np.arange(int(used.sum()))
    triangles = np.concatenate([
        np.stack([number[corners[i]][keep] for i in triangle], axis=1)
        for keep, triangle in zip(kept, order, strict=True)
    ]).astype(np.uint32)  # fmt: skip
    v, u = np.nonzero(used)
    pixels = np.stack([columns[u], rows[v]], axis=1).astype(np.float64)
    rays = cv2.undistortPoints(pixels[:, None], np.asarray(camera_matrix, float), np.asarray(distortion, float))[:, 0]
    points = np.concatenate([rays * z[used][:, None], z[used][:, None]], axis=1).astype(np.float32)
    texture = ((pixels + 0.5) / (width, height)).astype(np.float32)
    return TexturedMesh(points, texture, triangles, picture, np.asarray(camera_matrix, float))


_ARRAY, _ELEMENTS, _FLOAT, _UINT32 = 34962, 34963, 5126, 5125  # of the specification
_NEAR_M = 0.01  # where a viewer that looks through the camera begins; chosen by hand


def glb_bytes(mesh: TexturedMesh, *, name: str = "photograph", quality: int = 92) -> bytes:
    """Return the content of a .glb file: metres, y up; the camera is at the origin and looks along -z, as glTF has it.

    ``name``: of the nodes; ``quality``: of the JPEG texture.

    A camera of glTF looks through the middle of its picture: how far the optical axis is from there stands in the
    ``extras`` of the camera, with the whole matrix. The material is unlit: the photograph holds its light already.
    """
    positions = (mesh.vertices_mm * np.array([1, -1, -1], np.float32) / 1000).astype("<f4")
    texture, indices = mesh.texture.astype("<f4"), mesh.triangles.astype("<u4")
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(mesh.picture)).save(file, "JPEG", quality=quality, subsampling=0)
    height, width = mesh.picture.shape[:2]
    k = mesh.camera_matrix
    camera = {
        "type": "perspective",
        "name": f"{name} camera",
        "perspective": {
            "yfov": 2 * math.atan(height / 2 / k[1, 1]),
            "aspectRatio": width * k[1, 1] / (height * k[0, 0]),
            "znear": _NEAR_M,
        },
        "extras": {"camera_matrix_px": k.tolist(), "width_px": width, "height_px": height},
    }
    tree = {
        "asset": {"version": "2.0", "generator": "chromaperture"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "name": name}, {"camera": 0, "name": f"{name} camera"}],
        "cameras": [camera],
        "meshes": [{
            "name": name,
            "primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}],
        }],
        "materials": [{
            "name": name,
            "doubleSided": True,
            "extensions": {"KHR_materials_unlit": {}},
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
        }],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33071}],  # the edge of the picture is not its other edge
        "images": [{"bufferView": 3, "mimeType": "image/jpeg", "name": name}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": len(positions), "type": "VEC3",
             "min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": _FLOAT, "count": len(texture), "type": "VEC2"},
            {"bufferView": 2, "componentType": _UINT32, "count": indices.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    return glb_file(tree, [positions, texture, indices, np.frombuffer(file.getvalue(), np.uint8)])


def glb_file(tree: dict[str, Any], parts: Sequence[np.ndarray]) -> bytes:
    """Return a binary glTF 2.0 file of a tree and its buffer: two arrays of the vertices, indices, then pictures."""
    views: list[dict[str, Any]] = []
    at = 0
    for data, target in zip(parts, (_ARRAY, _ARRAY, _ELEMENTS, None), strict=False):
        kind = {"target": target} if target else {}
        views.append({"buffer": 0, "byteOffset": at, "byteLength": data.nbytes, **kind})
        at += data.nbytes
    text = json.dumps({**tree, "bufferViews": views, "buffers": [{"byteLength": at}]}).encode()
    text += b" " * (-len(text) % 4)
    padding = b"\0" * (-at % 4)
    size = at + len(padding)
    header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + size)
    texts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", size, b"BIN\0")
    return b"".join([header, texts, *(part.data for part in parts), padding])  # one copy: models have many megabytes


_SENSOR_MM = 36.0  # width of the camera's aperture; only its ratio to the focal length matters


def usd() -> Any:
    """Import the modules of OpenUSD; raises MissingDependencyError naming the extra."""
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt
    except ImportError:
        raise MissingDependencyError("USDZ files need the extra: pip install 'chromaperture[usd]'") from None
    return Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt


def write_usdz(path: str | Path, mesh: TexturedMesh) -> None:
    """Write a package of geometry, texture and camera: metres, y up, the camera at the origin, looking along -z."""
    _, _, stages, geometry, _, utilities, _ = usd()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.usdc"
        ok, encoded = cv2.imencode(".jpg", mesh.picture[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, 92))
        if not ok:
            raise InputError("the texture cannot be encoded")
        (Path(folder) / "texture.jpg").write_bytes(encoded.tobytes())
        stage = stages.Stage.CreateNew(str(scene))
        geometry.SetStageMetersPerUnit(stage, 1.0)
        geometry.SetStageUpAxis(stage, geometry.Tokens.y)
        root = geometry.Xform.Define(stage, "/photograph")
        stage.SetDefaultPrim(root.GetPrim())
        _add_mesh(stage, mesh)
        _add_camera(stage, mesh)
        stage.GetRootLayer().Save()
        target = str(Path(folder) / "packed.usdz")
        if not utilities.CreateNewUsdzPackage(str(scene), target):
            raise InputError(f"OpenUSD could not write {Path(path).name}; try another --write")
        Path(path).write_bytes(Path(target).read_bytes())


def _add_mesh(stage: Any, mesh: TexturedMesh) -> None:
    _, types, _, geometry, shade, _, arrays = usd()
    surface = geometry.Mesh.Define(stage, "/photograph/surface")
    points = mesh.vertices_mm * np.array([1, -1, -1], np.float32) / 1000
    surface.CreatePointsAttr(arrays.Vec3fArray.FromNumpy(np.ascontiguousarray(points, np.float32)))
    surface.CreateFaceVertexCountsAttr(arrays.IntArray.FromNumpy(np.full(len(mesh.triangles), 3, np.int32)))
    surface.CreateFaceVertexIndicesAttr(arrays.IntArray.FromNumpy(mesh.triangles.astype(np.int32).ravel()))
    surface.CreateSubdivisionSchemeAttr(geometry.Tokens.none)
    surface.CreateDoubleSidedAttr(True)
    extent = np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float32)
    surface.CreateExtentAttr(arrays.Vec3fArray.FromNumpy(extent))
    texture = np.stack([mesh.texture[:, 0], 1 - mesh.texture[:, 1]], axis=1).astype(np.float32)  # USD: upwards
    places = geometry.PrimvarsAPI(surface).CreatePrimvar(
        "st", types.ValueTypeNames.TexCoord2fArray, geometry.Tokens.vertex
    )
    places.Set(arrays.Vec2fArray.FromNumpy(np.ascontiguousarray(texture)))
    material = shade.Material.Define(stage, "/photograph/material")
    shader = shade.Shader.Define(stage, "/photograph/material/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    # Shown as it was photographed: emitted, for the photograph holds its light already.
    shader.CreateInput("diffuseColor", types.ValueTypeNames.Color3f).Set((0.0, 0.0, 0.0))
    shader.CreateInput("roughness", types.ValueTypeNames.Float).Set(1.0)
    reader = shade.Shader.Define(stage, "/photograph/material/place")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.ValueTypeNames.String).Set("st")
    picture = shade.Shader.Define(stage, "/photograph/material/picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", types.ValueTypeNames.Asset).Set("texture.jpg")
    picture.CreateInput("sourceColorSpace", types.ValueTypeNames.Token).Set("sRGB")
    for axis in ("wrapS", "wrapT"):
        picture.CreateInput(axis, types.ValueTypeNames.Token).Set("clamp")
    picture.CreateInput("st", types.ValueTypeNames.Float2).ConnectToSource(
        reader.CreateOutput("result", types.ValueTypeNames.Float2)
    )
    shader.CreateInput("emissiveColor", types.ValueTypeNames.Color3f).ConnectToSource(
        picture.CreateOutput("rgb", types.ValueTypeNames.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.ValueTypeNames.Token))
    shade.MaterialBindingAPI.Apply(surface.GetPrim()).Bind(material)


def _add_camera(stage: Any, mesh: TexturedMesh) -> None:
    vectors, _, _, geometry, _, _, _ = usd()
    height, width = mesh.picture.shape[:2]
    k, pixel = mesh.camera_matrix, _SENSOR_MM / width
    camera = geometry.Camera.Define(stage, "/photograph/camera")
    # A pixel of another height than width: one focal length, apertures in proportion.
    camera.CreateFocalLengthAttr(float(k[0, 0] * pixel))
    camera.CreateHorizontalApertureAttr(float(width * pixel))
    camera.CreateVerticalApertureAttr(float(height * pixel * k[0, 0] / k[1, 1]))
    # Of the picture's middle from the optical axis, to the right and upwards.
    camera.CreateHorizontalApertureOffsetAttr(float(((width - 1) / 2 - k[0, 2]) * pixel))
    camera.CreateVerticalApertureOffsetAttr(float((k[1, 2] - (height - 1) / 2) * pixel * k[0, 0] / k[1, 1]))
    camera.CreateClippingRangeAttr(vectors.Vec2f(0.01, 1000.0))  # m
