"""The built-in layouts; docs/output.md lists the loaders that read them.

In names of files, 0 is the left view and 1 the right view. The endings follow from the encodings.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from semisynth_gl.codecs import FLOW_CODECS, Encodings
from semisynth_gl.codecs.jpeg import JPEG
from semisynth_gl.codecs.json_object import JsonObject
from semisynth_gl.codecs.png16 import CRESTEREO_DISPARITY, KITTI_DISPARITY
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.channels import CHANNELS, MOTION_OUTPUTS, ViewArrays
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.layouts.layout import Layout, PairKey, view_stems
from semisynth_gl.layouts.roles import FILE_ROLES, StorablePair
from semisynth_gl.seeds.splits import SplitName

_PAIR_LINE = "{left} {right} {disparity_left}\n"


def _below(folder: str, names: Mapping[str, str]) -> dict[str, str]:
    """Return the paths of names, by role, in a folder."""
    return {role: f"{folder}{name}" for role, name in names.items()}


# Middlebury's scenes, and layouts like them

_SCENE = {
    "image": "im{n}",
    "instances": "inst{n}",
    "visibility": "mask{n}nocc",
    "flow_visibility": "flow_mask{n}",
    "flow_backward_visibility": "flow_backward_mask{n}",
}
# Flow and its masks, first those of the left view.
_FLOW = {
    channel.role(eye): view_stems(_SCENE, "{channel}{n}")[channel.role(eye)]
    for eye in EYES
    for channel in CHANNELS.values()
    if channel.output in MOTION_OUTPUTS
}
# y_left - y_right, in pairs that are not rectified.
_VERTICAL = {"disparity_y_left": "disp0y", "disparity_y_right": "disp1y"}
_METADATA = {"calibration": "calib", "provenance": "pair"}


def _without_flow(**names: str) -> dict[str, str]:
    """Return names by role of all channels but flow and its masks."""
    stems = view_stems(_SCENE | names, "{channel}{n}")
    return {role: stem for role, stem in stems.items() if role not in _FLOW}


_MIDDLEBURY_NAMES = _without_flow(disparity="disp{n}GT")

_MIDDLEBURY = Layout(
    stems=_below("MiddEval3/trainingF/{name}/", _MIDDLEBURY_NAMES | _VERTICAL | _FLOW | _METADATA),
    lists={"MiddEval3/official_train.txt": "{name}\n"},
    # Loaders of half or quarter size list the scenes in one of these folders, and may read them in a different one.
    links={
        "carla-highres/trainingF": "../MiddEval3/trainingF",
        "MiddEval3/trainingH": "trainingF",
        "MiddEval3/trainingQ": "trainingF",
    },
    three_channels=True,  # for RAFT-Stereo's demo and HSM's submission
)

# Both folders hold the same scenes, since loaders sort the folders and pair them by position.
_ETH3D = Layout(
    stems=_below("two_view_training/{name}/", {"left": "im0", "right": "im1", "calibration": "calib"})
    | _below(
        "two_view_training_gt/{name}/",
        {role: name for role, name in _MIDDLEBURY_NAMES.items() if role not in EYES} | {"provenance": "pair"} | _FLOW,
    ),
    links={f"ETH3D/{folder}": f"../{folder}" for folder in ("two_view_training", "two_view_training_gt")},
    needs=frozenset({"visibility"}),
    lacks=frozenset({"correspondence"}),
    encodings=Encodings(),
    three_channels=True,  # for RAFT-Stereo's demo; ETH3D's own grey images have three channels too
)

# im1E and im1L are the right image one stop darker and one stop brighter. torchvision selects the scenes that end in
# ``-perfect``.
_MIDDLEBURY_2014 = Layout(
    stems=_below(
        "2014/{name}-perfect/",
        {"left": "im0", "right": "im1", "right_under": "im1E", "right_over": "im1L"}
        | _without_flow(disparity="disp{n}")
        | _VERTICAL
        | _METADATA
        | _FLOW,
    ),
    lists={
        "Middlebury2014/train/Adirondack-not-included.txt": "Adirondack is not included. This file is here because "
        "torchvision refuses a folder without a name that begins as one of Middlebury's own scenes does.\n"
    },
    links={"Middlebury2014/train/{name}-perfect": "../../2014/{name}-perfect"},
    needs=frozenset({"visibility"}),
    encodings=Encodings(),
)


# KITTI 2015. Masks have no file: they follow from disparities and flow, see `mask_from_not_occluded`. KITTI itself
# lacks the folders ``pairs`` and ``filenames``. In a dataset with flow, names have the numbers of sequence and frame,
# and each frame has all files. Loaders look for the calibration of the first frame under the sequence's number only.

# KITTI numbers frames with two digits from here on.
_FIRST_FRAME = 10
_CHANNEL_FOLDERS = {role: stem for role, stem in view_stems({}, "{channel}_{n}").items() if "visibility" not in role}
# Records list a pair's files in this order.
_KITTI_FOLDERS = {
    "left": "image_2",
    "right": "image_3",
    "disparity_left": "disp_occ_0",
    "not_occluded_left": "disp_noc_0",
    "disparity_right": "disp_occ_1",
    "not_occluded_right": "disp_noc_1",
    "objects": "obj_map",
    **{role: _CHANNEL_FOLDERS[role] for role in ("instances_left", "instances_right", "depth_left", "depth_right")},
    **{
        f"{flow}_{seen}{eye}": f"{flow}_{short}{'' if eye == 'left' else '_right'}"
        for flow in ("flow", "flow_backward")
        for eye in EYES
        for seen, short in (("", "occ"), ("not_occluded_", "noc"))
    },
}
_KITTI_FOLDERS |= {role: folder for role, folder in _CHANNEL_FOLDERS.items() if role not in _KITTI_FOLDERS}


def _kitti_fields(key: PairKey) -> dict[str, str]:
    number = f"{key.sequence:06d}"
    name = f"{number}_{_FIRST_FRAME + key.frame}"
    return {
        "file": name,
        "calib": name if key.frame else number,
        "pair": number if key.sequence_length is None else name,
    }


_KITTI = Layout(
    stems={role: f"training/{folder}/{{file}}" for role, folder in _KITTI_FOLDERS.items()}
    | {"calib_cam_to_cam": "training/calib_cam_to_cam/{calib}", "provenance": "pairs/{pair}"},
    fields=_kitti_fields,
    lists={"filenames/KITTI_2015_{short_split}.txt": _PAIR_LINE},
    links={"Kitti2015/training": "../training"},
    flow_links={"KittiFlow/training": "../training"},
    needs=frozenset({"visibility", "instances"}),
    lacks=frozenset({"correspondence"}),
    encodings=Encodings(disparity=KITTI_DISPARITY, flow=FLOW_CODECS["png16"]),
    most_frames=100 - _FIRST_FRAME,
)


# SceneFlow's FlyingThings3D. Training pairs are under TRAIN and test pairs under TEST of one tree; validation pairs
# are under TEST of a second tree. Pair 0 is in A, pair 1 in B, pair 2 in C, pair 3 in A. A folder holds up to 1000
# frames, from 0000 on: loaders sort or list frames, and do not use their numbers. Loaders of flow treat successive
# images in a folder as successive frames. So in a dataset with flow, each folder is a sequence: sequence 0 is A/0000,
# sequence 1 is B/0000, and frame k of a sequence is 000k.

_THINGS = "SceneFlow/FlyingThings3D"
_CLEAN = "frames_cleanpass"
_FRAMES = 1000
# The scenes of SceneFlow's Driving.
_DRIVING = [
    f"{length}mm_focallength/scene_{way}wards/{speed}"
    for length in (35, 15)
    for way in ("back", "for")
    for speed in ("fast", "slow")
]
_PARTS: Mapping[SplitName, str] = {"train": "TRAIN", "validation": "TEST", "test": "TEST"}


def _things_fields(key: PairKey) -> dict[str, str]:
    number, letter = divmod(key.sequence, len("ABC"))
    folder, frame = divmod(number, _FRAMES) if key.sequence_length is None else (number, key.frame)
    return {"folder": f"{_PARTS[key.split]}/{'ABC'[letter]}/{folder:04d}", "file": f"{frame:04d}"}


_SCENEFLOW = Layout(
    stems=_below(
        f"{_THINGS}/",
        view_stems(
            {
                "image": _CLEAN + "/{folder}/{view}/{file}",
                "flow": "optical_flow/{folder}/into_future/{view}/OpticalFlowIntoFuture_{file}_{L}",
                "flow_visibility": "optical_flow_visibility/{folder}/into_future/{view}/{file}",
                "flow_backward": "optical_flow/{folder}/into_past/{view}/OpticalFlowIntoPast_{file}_{L}",
                "flow_backward_visibility": "optical_flow_visibility/{folder}/into_past/{view}/{file}",
                "disparity_change": "disparity_change/{folder}/into_future/{view}/{file}",
            },
            "{channel}/{folder}/{view}/{file}",
        )
        | {"provenance": "pairs/{folder}/{file}"},
    ),
    fields=_things_fields,
    lists={
        "filenames/sceneflow_{short_split}.txt": _PAIR_LINE,
        "filenames/SceneFlow_finalpass_{short_split}.txt": _PAIR_LINE,
    },
    # PSMNet looks for disparities under the first path, RAFT-Stereo and IGEV for more images under the second.
    links={f"{_THINGS}/frames_disparity": "disparity", f"{_THINGS}/frames_finalpass": _CLEAN},
    # PSMNet and HSM list these folders.
    folders=tuple(
        f"{_THINGS}/{folder}"
        for tree in (_CLEAN, "disparity")
        for folder in (
            *(f"{tree}/{part}/{letter}" for part in ("TRAIN", "TEST") for letter in "ABC"),
            f"monkaa_{tree}",
            *(f"driving_{tree}/{scene}/left" for scene in _DRIVING),
        )
    ),
    splits_in_root=frozenset({"train", "test"}),
    lacks=frozenset({"correspondence"}),
    encodings=Encodings(flow=FLOW_CODECS["pfm"]),
    most_frames=10_000,
)


# CREStereo. Pair 0 is in shapenet, pair 1 in reflective and so on; torchvision needs pairs in all four folders.
# CREStereo's dataset has only images and disparities. WAFT-Stereo looks for the pairs a folder deeper than torchvision.
# Its links are outside ``CREStereo``, since CREStereo's loader reads all files below that folder.

_KINDS = ("shapenet", "reflective", "tree", "hole")

_CRESTEREO = Layout(
    stems=_below(
        "CREStereo/{kind}/{index:06d}",
        view_stems(
            {
                "image": "_{view}",
                "disparity": "_{view}.disp",
                "visibility": "_{view}.mask",
                "instances": "_{view}.inst",
                "flow_visibility": "_{view}.flow_mask",
                "flow_backward_visibility": "_{view}.flow_backward_mask",
            },
            "_{view}.{channel}",
        )
        | {"provenance": ""},
    ),
    fields=lambda key: {"kind": _KINDS[key.index % len(_KINDS)]},
    links={"WAFT-Stereo/CREStereo/{kind}/0": "../../../CREStereo/{kind}"},
    lacks=frozenset({"correspondence", "raw"}),  # JPEG is too lossy for raw images
    encodings=Encodings(image=JPEG, disparity=CRESTEREO_DISPARITY),
)


# WebDataset: shards are tars. Files with the same text before the first dot, such as ``00000012``, are a pair. Hugging
# Face's loader needs the same keys and types in the JSON of every pair, so the provenance is stored as text.

_SIZES = ("width_px", "height_px")
_LENGTHS = ("focal_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px", "doffs_px")


def _webdataset_values(pair: StorablePair) -> dict[str, Any]:
    """Return the keys that the provenance of every pair has, and the whole provenance as text."""
    provenance, camera = pair.provenance, pair.frame.camera
    numbers: dict[str, Any] = {name: int(getattr(camera, name)) for name in _SIZES}
    numbers |= {name: float(getattr(camera, name)) for name in _LENGTHS}
    # Either all pairs of a dataset have these keys, or none.
    recorded = provenance.get("camera", {})
    numbers |= {key: recorded[key] for key in ("fy_over_fx", "deviation") if key in recorded}
    beyond = provenance.get(ViewArrays.disparity.beyond_key, {})
    return {
        "pair": int(provenance["pair"]),
        "split": str(provenance["split"]),
        **{name: str(provenance[name]) for name in ("config", "config_sha256", "version", "renderer", "backend")},
        **{name: int(provenance[name]) for name in ("seed", "sequence", "frame")},
        **({"view": int(provenance["view"])} if "view" in provenance else {}),
        "near_m": float(provenance["near_m"]),
        "camera": numbers,
        "ndisp": int(pair.ndisp),
        "redrawn": len(provenance.get("redrawn", ())),
        "beyond_left": int(beyond.get("left", 0)),
        "beyond_right": int(beyond.get("right", 0)),
        "provenance": json.dumps(provenance),
    }


class _WebDatasetJson(JsonObject):
    """JSON of `_webdataset_values`; `decode` returns the provenance."""

    def decode(self, data: bytes, path: Path) -> dict[str, Any]:
        text = super().decode(data, path).get("provenance")
        if not isinstance(text, str):
            raise ReadError(path, f"expected the provenance as text, got {type(text).__name__}")
        return super().decode(text.encode(), path)


_WEBDATASET = Layout(
    stems=_below("{index:08d}.", _without_flow(image="{view}", disparity="disp{n}", visibility="mask{n}") | _FLOW)
    | {"provenance": "{index:08d}"},
    roles={
        "provenance": replace(FILE_ROLES["provenance"], codec=lambda _: _WebDatasetJson(), value=_webdataset_values)
    },
    packed=True,
)

BUILT_IN: Mapping[str, Layout] = {
    "crestereo": _CRESTEREO,
    "eth3d": _ETH3D,
    "kitti": _KITTI,
    "middlebury": _MIDDLEBURY,
    "middlebury-2014": _MIDDLEBURY_2014,
    "sceneflow": _SCENEFLOW,
    "webdataset": _WEBDATASET,
}
