"""Croissant 1.1: what a dataset is and where its files are, as JSON-LD for hubs and search engines.

Files of one role and split make a file set, and a record set with one record a pair: the pair's key, the split, and the
file's content. Records of one key belong together.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import PurePosixPath
from typing import Any

from semisynth_gl.codecs import Codec
from semisynth_gl.dataset.files import plan_from_values
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.splits import SplitName

_VERSION = "http://mlcommons.org/croissant/1.1"
# Croissant's own: readers compare it key by key.
_CONTEXT: Mapping[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_SPLITS: Mapping[SplitName, str] = {
    "train": "cr:TrainingSplit",
    "validation": "cr:ValidationSplit",
    "test": "cr:TestSplit",
}
_UNKNOWN = "unknown"
_DIGITS = "0123456789"
# Of sequences, or of pairs that are named by themselves: names differ wherever those of any two pairs can.
_SAMPLES = (0, 1, 3, 123_456)


@dataclass(frozen=True, slots=True)
class _FileSet:
    """The files of one role and split; the stars of the pattern tell the pair."""

    split: SplitName
    role: str
    pattern: str
    codec: Codec[Any]

    @property
    def id(self) -> str:
        return f"{self.split}-{self.role}-files"


def encode_croissant(index: Mapping[str, Any]) -> bytes:
    """Encode a dataset's croissant.json, which follows from its index alone.

    Left out is what nobody told: when it was published, by whom, where it is, and how to cite it.

    Args:
        index: as `semisynth_gl.dataset.index.describe_dataset` returns it.

    Returns:
        JSON-LD, readable, with a line break at the end.
    """
    plan = plan_from_values(index)
    tars = _tars(index)
    file_sets = [file_set for split in plan.splits for file_set in _file_sets(plan, split)]
    width, height = plan.config.camera.width_px, plan.config.camera.height_px
    licence = plan.config.licences.dataset
    described: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": plan.config.name,
        "description": (
            f"{sum(plan.pairs.values())} rectified stereo pairs of {width} x {height} pixels with exact disparity, "
            "rendered: models textured with patches of photographs fall through a scene. Disparity is x_left - x_right "
            "in pixels, positive. Record sets hold one file of each pair; records of one key belong together."
        ),
        "conformsTo": _VERSION,
        "version": index["version"],
        "keywords": ["stereo", "disparity", "synthetic"],
    }
    if licence != _UNKNOWN:
        described["license"] = licence
    several = len(plan.splits) > 1
    described["distribution"] = [_file_object(shard) for shard in index["shards"] if "tar" in shard]
    described["distribution"] += [_describe_file_set(each, tars.get(each.split, ())) for each in file_sets]
    described["recordSet"] = [_splits(plan.splits)] if several else []
    described["recordSet"] += [_record_set(each, several=several) for each in file_sets]
    return (json.dumps(described, indent=1) + "\n").encode()


def _file_sets(plan: Plan, split: SplitName) -> list[_FileSet]:
    """Return a file set for each role's files, below the dataset's folder or inside a tar."""
    layout = plan.layout
    encodings = layout.encodings_for(plan.config)
    length = plan.key(split, 0).sequence_length or 1
    indices = (*(length * number for number in _SAMPLES), min(1, length - 1))
    config = plan.config
    pairs = [layout.files(plan.key(split, index), encodings, config.outputs, config.truth) for index in indices]
    folder = "" if layout.packed else plan.folder(split)
    return [
        _FileSet(split, role, folder + _pattern([files[role] for files in pairs]), layout.role(role).codec(encodings))
        for role in pairs[0]
    ]


def _pattern(paths: Sequence[str]) -> str:
    return "/".join(_joined(parts) for parts in zip(*(path.split("/") for path in paths), strict=True))


def _joined(parts: Sequence[str]) -> str:
    """Put a star where names differ; numbers are not cut in two."""
    if len(set(parts)) == 1:
        return parts[0]
    begin = _common(parts).rstrip(_DIGITS)
    end = _common([part[::-1] for part in parts])[::-1].lstrip(_DIGITS)
    return f"{begin}*{end}"


def _common(texts: Sequence[str]) -> str:
    """Return what all begin with."""
    return "".join(each[0] for each in takewhile(lambda each: len(set(each)) == 1, zip(*texts, strict=False)))


def _tars(index: Mapping[str, Any]) -> dict[str, list[str]]:
    tars: dict[str, list[str]] = {}
    for shard in index["shards"]:
        if "tar" in shard:
            tars.setdefault(shard["split"], []).append(shard["tar"])
    return tars


def _file_object(shard: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": shard["tar"],
        "name": PurePosixPath(shard["tar"]).name,
        "contentUrl": shard["tar"],
        "contentSize": f"{shard['bytes']} B",
        "encodingFormat": "application/x-tar",
        "sha256": shard["sha256"],
    }


def _describe_file_set(file_set: _FileSet, tars: Sequence[str]) -> dict[str, Any]:
    contained = {"containedIn": [{"@id": tar} for tar in tars]} if tars else {}
    return {
        "@type": "cr:FileSet",
        "@id": file_set.id,
        "name": file_set.id,
        **contained,
        "encodingFormat": file_set.codec.media_type,
        "includes": file_set.pattern,
    }


def _record_set(file_set: _FileSet, *, several: bool) -> dict[str, Any]:
    name, split = f"{file_set.split}-{file_set.role}", file_set.split
    source = {"fileSet": {"@id": file_set.id}}
    regexes = _key_regexes(file_set.pattern)
    # A pair's key in all roles is what stands for the stars, each a field. It does not reference the other record sets'
    # keys though it could: mlcroissant then joins what it has not read yet, and fails.
    keys = [
        {
            "@type": "cr:Field",
            "@id": f"{name}/key" if len(regexes) == 1 else f"{name}/key_{number}",
            "dataType": "sc:Text",
            "source": source | {"extract": {"fileProperty": "fullpath"}, "transform": {"regex": regex}},
        }
        for number, regex in enumerate(regexes, 1)
    ]
    of_split: dict[str, Any] = {"@type": "cr:Field", "@id": f"{name}/split", "dataType": "sc:Text", "value": split}
    if several:
        of_split["references"] = {"field": {"@id": "splits/name"}}
    content = {
        "@type": "cr:Field",
        "@id": f"{name}/content",
        "dataType": "sc:ImageObject" if file_set.codec.is_image else "sc:Text",
        "source": source | {"extract": {"fileProperty": "content"}},
    }
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "key": [{"@id": key["@id"]} for key in keys],
        "field": [*keys, of_split, content],
    }


def _key_regexes(pattern: str) -> list[str]:
    """Return for each star of a glob a regex that captures what stands for it; readers may put folders in front."""
    parts = [re.escape(part) for part in pattern.split("*")]
    return [
        "^(?:.*/)?"
        + "".join(
            part + ("" if at == len(parts) - 1 else "([^/]+)" if at == star else "[^/]+")
            for at, part in enumerate(parts)
        )
        + "$"
        for star in range(len(parts) - 1)
    ]


def _splits(splits: Sequence[SplitName]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            {"@type": "cr:Field", "@id": "splits/name", "dataType": "sc:Text"},
            {"@type": "cr:Field", "@id": "splits/url", "dataType": ["sc:URL", "cr:Split"]},
        ],
        "data": [{"splits/name": split, "splits/url": _SPLITS[split]} for split in splits],
    }
