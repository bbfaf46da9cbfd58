"""ASDF files of other people: only plain YAML and uncompressed float arrays reach asdf, which opens what is named."""

from __future__ import annotations

import io
import math
import re
import struct
import warnings
from pathlib import Path
from typing import Any

import asdf
import yaml
from asdf.exceptions import AsdfPackageVersionWarning

from chromaperture.system.validation import read_bytes

# Three qualities of two maps each, on a grid of every sixth pixel of 100 megapixels, take 67 MB.
_MOST_BYTES, _MOST_BLOCKS = 256_000_000, 32
_MOST_TREE_BYTES = 1_000_000  # of the YAML text: shipped cameras have 95 KB, of which 70 KB are covariances
_MOST_NODES, _MOST_LEVELS = 200_000, 40  # of the tree, with what aliases repeat: shipped cameras have 10,000 and 7
_LONGEST_SCALAR = 20_000  # characters; YAML reads 1:1:1:... as one number, in the square of its length
_END_OF_TREE = re.compile(rb"\r?\n\.\.\.(\r?\n|$)")
_BLOCK, _BLOCK_INDEX = b"\xd3BLK", b"#ASDF BLOCK INDEX"
_HEADER = struct.Struct(">I4sQQQ16s")  # flags, compression, allocated, used and unpacked bytes, checksum
_YAML, _CORE = "tag:yaml.org,2002:", "tag:stsci.edu:asdf/core/"
_PLAIN_TAGS = {_YAML + name for name in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")}
_CORE_TAG = re.compile(re.escape(_CORE) + r"(asdf|software|extension_metadata|history_entry|ndarray)-[\d.]{1,20}")
_ITEM_BYTES = {"float32": 4, "float64": 8}
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_tree(path: str | Path) -> dict[str, Any]:
    """Read the tree of an ASDF file of plain values and float arrays.

    Raises InputError: the file cannot be read, or is too large. Raises ValueError, yaml.YAMLError: it
    is damaged, or holds what a camera file has no use for: references to other files, other tags, compressed or
    streamed blocks, arrays whose size is not that of their block.
    """
    data = read_bytes(path, most_bytes=_MOST_BYTES)
    end = _END_OF_TREE.search(data, 0, _MOST_TREE_BYTES)
    if not data.startswith(b"#ASDF 1.") or end is None:
        raise ValueError(f"no ASDF tree in the first {_MOST_TREE_BYTES} bytes")
    sizes, last = _block_sizes(data, end.end())
    _check_tree(data[: end.end()].decode("utf-8"), sizes)
    with warnings.catch_warnings():
        # A newer asdf wrote the file: of that this needs nothing, what it needs was checked above.
        warnings.simplefilter("ignore", AsdfPackageVersionWarning)
        # Without the index of the blocks, which may point elsewhere.
        with asdf.open(io.BytesIO(data[:last]), lazy_load=False, memmap=False, validate_checksums=True) as file:
            return dict(file.tree)


def _block_sizes(data: bytes, start: int) -> tuple[list[int], int]:
    """Return the bytes of every block, and where the last ends; raises ValueError for blocks that need unpacking."""
    sizes: list[int] = []
    while data[start : start + 4] == _BLOCK:
        (length,) = struct.unpack_from(">H", data[start : start + 6].ljust(6, b"\0"), 4)
        body = start + 6 + length
        if length < _HEADER.size or body > len(data) or len(sizes) == _MOST_BLOCKS:
            raise ValueError("a block's header is cut off, or there are too many blocks")
        flags, compression, allocated, used, unpacked, _ = _HEADER.unpack_from(data, start + 6)
        if flags or compression.strip(b"\0") or not used == unpacked <= allocated <= len(data) - body:
            raise ValueError("a block is compressed, streamed or cut off")
        sizes.append(used)
        start = body + allocated
    if data[start:] and not data.startswith(_BLOCK_INDEX, start):
        raise ValueError("there are bytes behind the tree that are no block")
    return sizes, start


def _check_tree(text: str, sizes: list[int]) -> None:
    """Raise ValueError where the tree holds more than plain values and arrays of the blocks."""
    root = yaml.compose(text, Loader=_LOADER)
    waiting, count = [(root, 0)], 0
    while waiting:  # what an alias repeats is counted again; one that holds itself has no end
        node, level = waiting.pop()
        count += 1
        if count > _MOST_NODES or level > _MOST_LEVELS:
            raise ValueError("the tree is too large, too deep, or holds itself")
        if node.tag not in _PLAIN_TAGS and not _CORE_TAG.fullmatch(node.tag):
            raise ValueError(f"the tag {node.tag[:60]!r} is none of a camera file")
        if node.tag.startswith(_CORE + "ndarray-"):
            _check_array(node, sizes)
        if isinstance(node, yaml.ScalarNode):
            if len(node.value) > _LONGEST_SCALAR:
                raise ValueError(f"a value has {len(node.value)} characters")
        elif isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode) or key.value in ("$ref", "<<"):
                    raise ValueError("a key is a reference to another file, or no text")
                waiting += [(key, level + 1), (value, level + 1)]
        else:
            waiting += [(item, level + 1) for item in node.value]


def _check_array(node: yaml.Node, sizes: list[int]) -> None:
    """Raise ValueError unless an array is exactly one of the blocks, as floats."""
    parts = {key.value: part for key, part in node.value} if isinstance(node, yaml.MappingNode) else {}
    source, kind, shape = (parts.get(name) for name in ("source", "datatype", "shape"))
    if not parts.keys() <= {"source", "datatype", "byteorder", "shape"} or not isinstance(shape, yaml.SequenceNode):
        raise ValueError("an array is not a block of this file")
    lengths = [_whole(item) for item in shape.value]
    number, bytes_each = _whole(source), _ITEM_BYTES.get(getattr(kind, "value", ""))
    if number >= len(sizes) or bytes_each is None or math.prod(lengths[:4]) * bytes_each != sizes[number]:
        raise ValueError("an array is not a block of this file, or has another size")
    if len(lengths) > 4:
        raise ValueError("an array has more than four axes")


def _whole(node: yaml.Node | None) -> int:
    """Return a number of up to nine digits; raises ValueError for others, names of files among them."""
    text = node.value if isinstance(node, yaml.ScalarNode) and node.tag == _YAML + "int" else ""
    if not re.fullmatch(r"\d{1,9}", text):
        raise ValueError(f"{str(text)[:60]!r} is no number of an array")
    return int(text)
