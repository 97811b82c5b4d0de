"""Croissant 1.1: a description of a dataset and its files, as JSON-LD for hubs and search engines.

Files of the same role and split make a file set. Where mlcroissant returns their content unchanged, they also make a
record set with a record for each pair: the pair's key, the split, and the file's content. Records with the same key
belong to the same pair.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from semisynth_gl.codecs import Codec
from semisynth_gl.codecs.calib import KITTI_CALIB, MIDDLEBURY_CALIB
from semisynth_gl.codecs.grey import ThreeEqual
from semisynth_gl.codecs.jpeg import Jpeg
from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.dataset.begun import plan_of
from semisynth_gl.dataset.documents import IndexDocument, ShardEntry
from semisynth_gl.dataset.file_sets import FileSet, list_file_sets
from semisynth_gl.inputs.errors import counted
from semisynth_gl.seeds.splits import SplitName

_VERSION = "http://mlcommons.org/croissant/1.1"
_TERMS = """
    arrayShape citeAs column conformsTo containedIn cr rai data dataType dct description equivalentProperty
    examples extract field fileProperty fileObject fileSet format includes isArray isLiveDataset jsonPath key
    md5 name parentField path recordSet references regex repeated replace samplingRate sc separator source
    subField transform
    """.split()  # noqa: SIM905 - a long list reads better without quotes
# The context in Croissant's specification: readers compare it key by key.
_CONTEXT: Mapping[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{term: f"cr:{term}" for term in _TERMS},
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
    "sc": "https://schema.org/",
}
_SPLITS: Mapping[SplitName, str] = {
    "train": "cr:TrainingSplit",
    "validation": "cr:ValidationSplit",
    "test": "cr:TestSplit",
}
# Codecs of files in folders that mlcroissant returns unchanged: it converts every image to 8-bit RGB, and fails at
# formats that it does not know. From a tar it returns a file's bytes, or the image that Pillow reads.
_READ_IN_FOLDERS: tuple[Codec[Any], ...] = (RGB8, ThreeEqual(RGB8), Jpeg(), MIDDLEBURY_CALIB, KITTI_CALIB)


def encode_croissant(index: IndexDocument) -> bytes:
    """Encode a dataset's croissant.json from its index.

    Publisher, date, address and citation are left out, since the index does not know them.
    """
    plan = plan_of(index)
    tars = [shard for shard in index.shards if shard.tar is not None]
    file_sets = [file_set for split in plan.splits for file_set in list_file_sets(plan, split)]
    readable = [each for each in file_sets if plan.layout.packed or each.codec in _READ_IN_FOLDERS]
    width, height = plan.config.camera.width_px, plan.config.camera.height_px
    licence = plan.config.licences.dataset
    several = len(plan.splits) > 1
    sign = "signed" if plan.config.disparity.signed else "positive"
    described = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": plan.config.name,
        "description": (
            f"{counted(sum(plan.pairs.values()), f'{plan.kind} pair')} of {width} x {height} pixels with exact "
            "disparity, rendered: models textured with patches of images fall through a scene. Disparity is x_left - "
            f"x_right in pixels, {sign}. Record sets hold one file of each pair; records of one key belong together. "
            "File sets without a record set are for other readers, such as semisynth_gl.open_dataset."
        ),
        "conformsTo": _VERSION,
        "version": index.version,
        "keywords": ["stereo", "disparity", "synthetic"],
        **({} if licence == "unknown" else {"license": licence}),
        "distribution": [
            *(_file_object(tar) for tar in tars),
            *(_describe_file_set(file_set, tars) for file_set in file_sets),
        ],
        "recordSet": [
            *([_splits(plan.splits)] if several else []),
            *(_record_set(file_set, several=several) for file_set in readable),
        ],
    }
    return JSON_OBJECT.encode(described)


def _id(file_set: FileSet) -> str:
    return f"{file_set.split}-{file_set.role}-files"


def _file_object(shard: ShardEntry) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": shard.tar,
        "name": PurePosixPath(str(shard.tar)).name,
        "contentUrl": shard.tar,
        "contentSize": f"{shard.bytes} B",
        "encodingFormat": "application/x-tar",
        "sha256": shard.sha256,
    }


def _describe_file_set(file_set: FileSet, tars: Sequence[ShardEntry]) -> dict[str, Any]:
    own = [{"@id": tar.tar} for tar in tars if tar.split == file_set.split]
    contained = {"containedIn": own} if own else {}
    return _named(
        "FileSet",
        _id(file_set),
        description=file_set.meaning,
        **contained,
        encodingFormat=file_set.codec.media_type,
        includes=file_set.pattern,
    )


def _record_set(file_set: FileSet, *, several: bool) -> dict[str, Any]:
    name, split = f"{file_set.split}-{file_set.role}", file_set.split
    source = {"fileSet": {"@id": _id(file_set)}}
    regexes = _key_regexes(file_set.pattern)
    # The text that stands for each star is a field; together they are the pair's key, the same in all roles. The keys
    # do not reference other record sets: mlcroissant would join records before it reads them, and fail.
    keys = [
        _field(
            f"{name}/key" if len(regexes) == 1 else f"{name}/key_{number}",
            source=source | {"extract": {"fileProperty": "fullpath"}, "transform": {"regex": regex}},
        )
        for number, regex in enumerate(regexes, 1)
    ]
    references = {"references": {"field": {"@id": "splits/name"}}} if several else {}
    data_type = "sc:ImageObject" if file_set.codec.is_image else "sc:Text"
    content = _field(f"{name}/content", data_type, source=source | {"extract": {"fileProperty": "content"}})
    fields = [*keys, _field(f"{name}/split", value=split, **references), content]
    return _named("RecordSet", name, key=[{"@id": key["@id"]} for key in keys], field=fields)


def _named(kind: str, name: str, **properties: object) -> dict[str, Any]:
    return {"@type": f"cr:{kind}", "@id": name, "name": name, **properties}


def _field(name: str, data_type: object = "sc:Text", **properties: object) -> dict[str, Any]:
    return {"@type": "cr:Field", "@id": name, "dataType": data_type, **properties}


def _key_regexes(pattern: str) -> list[str]:
    """Return a regex for each star of a glob, which captures the star's text; folders may stand before the path."""
    parts = [re.escape(part) for part in pattern.split("*")]
    return [
        f"^(?:.*/)?{'[^/]+'.join(parts[:star])}([^/]+){'[^/]+'.join(parts[star:])}$" for star in range(1, len(parts))
    ]


def _splits(splits: Sequence[SplitName]) -> dict[str, Any]:
    return _named(
        "RecordSet",
        "splits",
        dataType="cr:Split",
        key={"@id": "splits/name"},
        field=[_field("splits/name"), _field("splits/url", ["sc:URL", "cr:Split"])],
        data=[{"splits/name": split, "splits/url": _SPLITS[split]} for split in splits],
    )
