"""A surface with its photograph and its camera as USDZ, for iPhones and film tools; needs the extra ``usd``."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from chromaperture.files.textured_mesh import TexturedMesh
from chromaperture.system.errors import InputError, MissingDependencyError

_SENSOR_MM = 36.0  # width of the camera's aperture; only its ratio to the focal length matters


def usd() -> Any:
    """Import the modules of OpenUSD; raises MissingDependencyError naming the extra."""
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt
    except ImportError:
        raise MissingDependencyError("USDZ files need the extra: pip install 'chromaperture[usd]'") from None
    return Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt


def write_usdz(path: str | Path, mesh: TexturedMesh) -> None:
    """Write a package of geometry, texture and camera: metres, y up, the camera at the origin, looking along -z.

    ``path``: ends in .usdz. Raises MissingDependencyError: the extra ``usd`` is not installed. Raises InputError:
    OpenUSD could not write the package.
    """
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
