"""A surface with its photograph and its camera as one glTF 2.0 file (Khronos, glTF 2.0 Specification, 2021)."""

from __future__ import annotations

import io
import json
import math
import struct
from typing import Any

import numpy as np
from PIL import Image

from chromaperture.files.textured_mesh import TexturedMesh

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
    parts = [positions.tobytes(), texture.tobytes(), indices.tobytes(), file.getvalue()]
    views: list[dict[str, Any]] = []
    at = 0
    for data, target in zip(parts, (_ARRAY, _ARRAY, _ELEMENTS, None), strict=True):
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(data)} | ({"target": target} if target else {}))
        at += len(data)
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
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)
    binary += b"\0" * (-len(binary) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return header + chunks
