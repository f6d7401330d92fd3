"""Files of ours as programs of others read them."""

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray
from PIL import Image
from pygltflib import GLTF2


class Glb:
    """A GLB's first mesh as pygltflib reads it."""

    def __init__(self, file: Path) -> None:
        self.gltf = GLTF2().load(str(file))
        (self.primitive,) = self.gltf.meshes[0].primitives
        (self.material,) = self.gltf.materials

    def _bytes(self, view: int) -> bytes:
        at = self.gltf.bufferViews[view]
        return self.gltf.binary_blob()[at.byteOffset : at.byteOffset + at.byteLength]

    def array(self, name: str) -> NDArray[np.float32]:
        accessor = self.gltf.accessors[getattr(self.primitive.attributes, name)]
        width = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
        return np.frombuffer(self._bytes(accessor.bufferView), np.float32)[: accessor.count * width].reshape(
            -1, width
        )

    def picture(self, texture: int) -> Image.Image:
        source = self.gltf.images[self.gltf.textures[texture].source]
        assert source.mimeType == "image/png"
        return Image.open(io.BytesIO(self._bytes(source.bufferView)))


class Exr:
    """An EXR file as OpenImageIO reads it."""

    def __init__(self, file: Path) -> None:
        source = OpenImageIO.ImageInput.open(str(file))
        assert source is not None, OpenImageIO.geterror()
        self.channels = tuple(source.spec().channelnames)
        self.pixels: NDArray[np.float32] = source.read_image("float")
        self.attributes = {entry.name: entry.value for entry in source.spec().extra_attribs}
        source.close()

    def __getitem__(self, channel: str) -> NDArray[np.float32]:
        return self.pixels[..., self.channels.index(channel)]


def chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and content of each chunk of a PNG, its check sum checked."""
    at = 8
    while at < len(data):
        (size,) = struct.unpack(">I", data[at : at + 4])
        name, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        assert struct.unpack(">I", data[at + 8 + size : at + 12 + size])[0] == zlib.crc32(name + body)
        yield name, body
        at += 12 + size
