"""glTF files of one triangle, (0, 0, 0) (1, 0, 0) (0, 1, 0), some with changed parts."""

import base64
import json
import struct

TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
DATA = "data:application/octet-stream;base64," + base64.b64encode(TRIANGLE).decode()


def document(uri=None, **parts):
    """Return a glTF document whose buffer is the file ``uri``; None for a GLB, which contains its buffer."""
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36} | ({"uri": uri} if uri is not None else {})],
    } | parts


def gltf(*arguments, **parts):
    return json.dumps(document(*arguments, **parts)).encode()


def glb(*arguments, **parts):
    header = gltf(*arguments, **parts)
    header += b" " * (-len(header) % 4)
    chunk = struct.pack("<I4s", len(header), b"JSON") + header
    if not arguments:
        chunk += struct.pack("<I4s", len(TRIANGLE), b"BIN\0") + TRIANGLE
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk
