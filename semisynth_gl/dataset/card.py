"""The dataset card: a README.md for people, with the front matter that hubs read."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from semisynth_gl.codecs import Codec
from semisynth_gl.config import Config
from semisynth_gl.config.yaml_values import write_yaml
from semisynth_gl.dataset.begun import plan_from_values
from semisynth_gl.dataset.file_sets import FileSet, list_file_sets
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.errors import counted
from semisynth_gl.frame import FLOW_OUTPUTS
from semisynth_gl.plugins import NOUNS
from semisynth_gl.splits import SplitName
from semisynth_gl.textures.sources import describe_source

# The names in the documentation of Hugging Face's hub; any other licence is "other" with a name of its own.
_LICENCES = frozenset(
    """
    apache-2.0 mit openrail bigscience-openrail-m creativeml-openrail-m bigscience-bloom-rail-1.0 bigcode-openrail-m
    afl-3.0 artistic-2.0 bsl-1.0 bsd bsd-2-clause bsd-3-clause bsd-3-clause-clear c-uda cc cc0-1.0 cc-by-2.0 cc-by-2.5
    cc-by-3.0 cc-by-4.0 cc-by-sa-3.0 cc-by-sa-4.0 cc-by-nc-2.0 cc-by-nc-3.0 cc-by-nc-4.0 cc-by-nd-4.0 cc-by-nc-nd-3.0
    cc-by-nc-nd-4.0 cc-by-nc-sa-2.0 cc-by-nc-sa-3.0 cc-by-nc-sa-4.0 cdla-sharing-1.0 cdla-permissive-1.0
    cdla-permissive-2.0 wtfpl ecl-2.0 epl-1.0 epl-2.0 etalab-2.0 eupl-1.1 agpl-3.0 gfdl gpl gpl-2.0 gpl-3.0 lgpl
    lgpl-2.1 lgpl-3.0 isc lppl-1.3c ms-pl mpl-2.0 odc-by odbl openrail++ osl-3.0 postgresql ofl-1.1 ncsa unlicense zlib
    pddl lgpl-lr unknown other
    """.split()  # noqa: SIM905 - so many words read better without quotes
)
_SIZE_NAMES = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
_UNITS = ("kB", "MB", "GB", "TB")
# Endings of the images that the package datasets finds in folders and Pillow opens.
_IMAGE_ENDINGS = (".png", ".jpg", ".tiff")
_MAIN_ROLE = "left"

_CAVEATS: Mapping[str, str] = {
    "kitti": (
        "In KITTI 2015, `disp_occ_1` and `disp_noc_1` are the next frame's disparity. Here they are the right view's, "
        "which is what torchvision and OpenStereo take them for. With the output disparity_change, `disp_occ_0` plus "
        "`disparity_change_0` is the next frame's."
    ),
    "middlebury-2014": (
        "`im1E` and `im1L` are the right image a stop darker and a stop brighter, computed from the same rendering."
    ),
    "crestereo": "Images are JPEG, as in CREStereo's dataset: they have lost a little.",
    "webdataset": (
        "The packages `datasets` and `webdataset` give PFM as bytes, and the latter's decoders `rgb8` and `pil` "
        "destroy 16-bit PNG: read these with `semisynth_gl.open_dataset`."
    ),
}


def encode_card(index: Mapping[str, Any]) -> bytes:
    """Encode a dataset's README.md from its index.

    Args:
        index: as `semisynth_gl.dataset.index.describe_dataset` returns it.

    Returns:
        YAML between two lines of dashes, and Markdown.
    """
    plan = plan_from_values(index)
    sections = (
        _introduction(plan),
        _splits(plan, index),
        _reading(plan, index),
        _files(plan),
        _disparity(plan),
        _flow(plan),
        _origin(plan, index),
        _rights(plan, index),
        _caveats(plan),
    )
    body = "\n\n".join(section for section in sections if section)
    return f"---\n{_front(plan, index)}---\n\n{body}\n".encode()


def _front(plan: Plan, index: Mapping[str, Any]) -> str:
    values: dict[str, Any] = {
        **_licence(plan.config.licences.dataset),
        "task_categories": ["depth-estimation"],
        "size_categories": [_size_category(sum(plan.pairs.values()))],
        "tags": [
            *("stereo", "disparity", "synthetic"),
            *(["optical-flow"] if _has_flow(plan) else []),
            *(["webdataset"] if plan.layout.packed else []),
        ],
        "pretty_name": _quoted(f"{plan.config.name} (semi-synthetic stereo)"),
    }
    if plan.layout.packed:
        files = [{"split": split, "path": _quoted(_glob(index, split))} for split in plan.splits]
        values["configs"] = [{"config_name": "default", "data_files": files}]
    else:
        values["configs"] = [_config(role, file_sets) for role, file_sets in _image_sets(plan).items()]
    return write_yaml(values)


def _config(role: str, file_sets: Sequence[FileSet]) -> dict[str, Any]:
    """Return the config of a role's images; without configs hubs take whatever they find, such as shards' records."""
    return {
        "config_name": role,
        **({"default": True} if role == _MAIN_ROLE else {}),
        "data_files": [{"split": each.split, "path": _quoted(each.pattern)} for each in file_sets],
        "drop_labels": True,  # else the folders' names become classes
    }


def _image_sets(plan: Plan) -> dict[str, list[FileSet]]:
    """Return the file sets of images in folders by role, one for each split; those of the left image in any format."""
    found: dict[str, list[FileSet]] = {}
    for split in plan.splits:
        for each in list_file_sets(plan, split):
            if each.role == _MAIN_ROLE or (each.codec.is_image and each.pattern.endswith(_IMAGE_ENDINGS)):
                found.setdefault(each.role, []).append(each)
    return found


def _licence(name: str) -> dict[str, str]:
    if name.lower() in _LICENCES:
        return {"license": name.lower()}
    slug = re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.")
    return {"license": "other"} | ({"license_name": _quoted(slug)} if slug else {})


def _quoted(text: str) -> str:
    # YAML 1.1, which hubs read, takes more words for numbers, dates and truth values than YAML 1.2 does.
    quoted: str = DoubleQuotedScalarString(text)
    return quoted


def _size_category(pairs: int) -> str:
    lower = ""
    for power, name in enumerate(_SIZE_NAMES, 3):
        if pairs < 10**power:
            return f"{lower}n<{name}"
        lower = f"{name}<"
    return f"n>{_SIZE_NAMES[-1]}"


def _introduction(plan: Plan) -> str:
    config = plan.config
    camera, disparity = config.camera, config.disparity
    patches = describe_source(config.textures.source).patches
    recipes = config.recipes()
    baselines = [range_m for recipe in recipes for range_m in recipe.config.camera.baseline_ranges_m]
    low, high = min(each.low for each in baselines), max(each.high for each in baselines)
    baseline = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    named = [f"{recipe.name} {recipe.share:.1%}" for recipe in recipes if recipe.name is not None]
    scenes = f"\n- Recipes of scenes, by their shares: {', '.join(named)}" if named else ""
    return (
        f"# {config.name}\n\n"
        f"{counted(sum(plan.pairs.values()), f'{plan.kind} pair')} with exact disparity, rendered with "
        "OpenGL. "
        f"Scenes are made of models that wear {patches}, so truth is computed and not measured.\n\n"
        f"- Images: {camera.width_px} x {camera.height_px} pixels\n"
        f"- Disparity: {disparity.min_px:g} to {disparity.max_px:g} px; none exceeds the upper end, a far plane may be "
        "below the lower one\n"
        f"- Baseline: {baseline} m{_of_views(config.views)}{_of_rig(config)}{scenes}"
    )


def _of_rig(config: Config) -> str:
    if config.rig.none():
        return ""
    twin = " Every other pair is the rectified twin of the one before it." if config.rig.twin else ""
    return (
        "\n- Rectification: imperfect. The right camera turns, and its principal point and focal length differ, by "
        f"what `deviation` in each pair's provenance says.{twin}"
    )


def _of_views(views: int) -> str:
    if views == 1:
        return ""
    return (
        f"; pairs {views} i to {views} i + {views - 1} of a split show one scene and have one left image, each with a "
        "right view of its own: keep them in one part where you divide a split"
    )


def _splits(plan: Plan, index: Mapping[str, Any]) -> str:
    rows = []
    for split in plan.splits:
        sizes = [shard["bytes"] for shard in index["shards"] if shard["split"] == split]
        photographs, patches = (len(index["splits"][split][key]) for key in ("photographs", "patches"))
        rows.append((split, plan.pairs[split], len(sizes), _bytes(sum(sizes)), photographs, patches))
    source = f"{describe_source(plan.config.textures.source).noun}s"
    apart = f"\n\n{source.title()} of one split show up in no other." if len(rows) > 1 and source != "patterns" else ""
    return "## Splits\n\n" + _table(("split", "pairs", "shards", "size", source, "patches"), rows) + apart


def _reading(plan: Plan, index: Mapping[str, Any]) -> str:
    lines = [
        "## Reading it",
        "",
        "```python",
        "from semisynth_gl import open_dataset",
        "",
        'pair = open_dataset("path/to/this/folder")[0]',
        "pair.left, pair.right, pair.left.disparity",
        "```",
    ]
    if package := plan.plugins.get("layouts", {}).get(plan.layout_name):
        lines += ["", f"This needs the layout's package too: `pip install {package['package']}=={package['version']}`."]
    if plan.layout.packed:
        lines += ["", "With the webdataset package:", "", "```python", "import webdataset", ""]
        lines += [
            f'{split} = webdataset.WebDataset("{_braces(index, split)}", shardshuffle=False)' for split in plan.splits
        ]
        files = ", ".join(f'"{split}": "{_glob(index, split)}"' for split in plan.splits)
        lines += ["```", "", "With the datasets package, in this folder:", "", "```python"]
        lines += ["from datasets import load_dataset", ""]
        lines += [f'load_dataset("webdataset", data_files={{{files}}}, streaming=True)', "```"]
        return "\n".join(lines)
    name, loaders = plan.layout.title
    lines += ["", f"Files stand as in {name}, for loaders of that: {loaders}."] if loaders else []
    return "\n".join(lines + _reading_images(plan))


def _reading_images(plan: Plan) -> list[str]:
    """Return how the package datasets loads images in folders, and what it cannot load."""
    file_sets = {each.role: each for each in list_file_sets(plan, plan.splits[0])}
    images = [role for role in _image_sets(plan) if file_sets[role].pattern.endswith(_IMAGE_ENDINGS)]
    others: dict[str, list[str]] = {}
    for role, each in file_sets.items():
        if role not in images:
            others.setdefault(each.codec.description, []).append(role)
    lines = ["", "The datasets package knows images alone."]
    if _MAIN_ROLE in images:
        lines[-1] += " In this folder:"
        lines += ["", "```python", "from datasets import load_dataset", ""]
        lines += [f'left = load_dataset(".", "{_MAIN_ROLE}")', "```", ""]
        lines += [f"The configs are {', '.join(images)}; row i of each is of the same pair."]
    cannot = "; ".join(f"{', '.join(roles)} ({description})" for description, roles in others.items())
    return [*lines, f"It cannot load: {cannot}."]


def _files(plan: Plan) -> str:
    layout, split = plan.layout, plan.splits[0]
    encodings = layout.encodings_for(plan.config)
    rows = [(role, f"`{path}`", layout.role(role).described(encodings)) for role, path in plan.files(split, 0).items()]
    where = f"in the tar of its shard, if it is of {split}" if layout.packed else f"if it is of {split}"
    return f"## What a pair holds\n\nPair 0, {where}:\n\n" + _table(("role", "file", "what it is"), rows)


def _disparity(plan: Plan) -> str:
    signed = plan.config.disparity.signed
    sentences = [
        "A disparity d is x_left - x_right, in pixels, in both views; it is signed: 0 and below are valid."
        if signed
        else "A disparity d is x_left - x_right, in pixels, and positive in both views.",
        "What the left view has at column x is at column x - d of the right one.",
        "What the right view has at column x is at column x + d of the left one.",
        *_storage(plan.layout.encodings_for(plan.config).disparity, "Beyond {:g} px" if signed else "Above {:g} px"),
    ]
    if any(recipe.config.background.shows_sky for recipe in plan.config.recipes()):
        sentences.append(
            "Some scenes have a sky: a backdrop that is infinitely far away, of disparity -doffs if that is valid, and "
            "of infinite depth."
        )
    return "## Disparity\n\n" + " ".join(sentences)


def _storage(codec: Codec[Any], beyond: str) -> list[str]:
    sentences = [f"It is stored as {codec.description}; {codec.nothing} says that there is none."]
    if codec.error_px:
        sentences.append(f"Rounding puts it off by at most {codec.error_px:g} px.")
    if isfinite(codec.limit_px):
        sentences.append(f"{beyond.format(codec.limit_px)} it cannot be stored: such pixels have none.")
    return sentences


def _has_flow(plan: Plan) -> bool:
    return not FLOW_OUTPUTS.isdisjoint(plan.config.outputs)


def _flow(plan: Plan) -> str:
    if not _has_flow(plan):
        return ""
    length, frame_s = plan.config.sequence.length, plan.config.sequence.frame_s
    pairs = length * plan.config.views
    frames = f"Pairs {pairs} i to {pairs} i + {pairs - 1} of a split are the frames of a sequence, {frame_s:g} s apart"
    sentences = [
        f"{frames}, {plan.config.views} pairs of each." if plan.config.views > 1 else f"{frames}.",
        "Flow (u, v) is where the point seen at a pixel is in the same view at another frame, minus the pixel.",
        "It is in pixels, u to the right and v downwards.",
        *_storage(plan.layout.encodings_for(plan.config).flow, "Beyond {:g} px in any direction"),
    ]
    return "## Flow\n\n" + " ".join(sentences)


def _origin(plan: Plan, index: Mapping[str, Any]) -> str:
    rows = [
        ("program", f"{index['program']} {index['version']}"),
        ("config", plan.config.name),
        ("SHA-256 of the config", f"`{index['config_sha256']}`"),
        ("seed", plan.seed),
        ("layout", plan.layout_name),
        *_plugins(plan),
        ("renderer", _escaped(", ".join(index["renderers"]))),
        ("redrawn", counted(index["redraws"], "attempt")),
    ]
    return (
        "## What made it\n\n"
        + _table(("", ""), rows)
        + "\n\n`index.json` has the whole config and the digests of all photographs, patches, models and shards."
    )


def _plugins(plan: Plan) -> list[tuple[str, str]]:
    """Return the rows of the plug-ins: what each is, and its package."""
    return [
        (f"{NOUNS[group]} {name}", f"plug-in package {package['package']} {package['version']}")
        for group, packages in plan.plugins.items()
        for name, package in packages.items()
    ]


def _rights(plan: Plan, index: Mapping[str, Any]) -> str:
    rows: list[tuple[str, str]] = []
    for source, key in (
        (describe_source(plan.config.textures.source).noun, "photographs"),
        ("kind of model", "models"),
    ):
        named = {(item["name"], item["licence"]) for split in index["splits"].values() for item in split[key]}
        counts = Counter(licence for _, licence in named)
        rows += [(counted(count, source), _escaped(licence)) for licence, count in sorted(counts.items())]
    return (
        f"## Rights\n\nThe dataset as a whole: {_escaped(plan.config.licences.dataset)}. It was made of:\n\n"
        + _table(("what", "licence"), rows)
    )


def _caveats(plan: Plan) -> str:
    layout = plan.layout
    caveats = [_CAVEATS[plan.layout_name]] if plan.layout_name in _CAVEATS else []
    if layout.folders() or any(layout.links([plan.key(split, 0)]) for split in plan.splits):
        caveats.append(
            "Some loaders look for links or empty folders that belong to this dataset; hubs, stores and many archives "
            "drop them."
        )
    for split in plan.splits:
        label = f"{split}: " if len(plan.splits) > 1 else ""
        caveats += [f"{label}{_escaped(advice)}" for advice in layout.advice(plan.pairs[split], plan.config, split)]
    return "## What to know\n\n" + "\n".join(f"- {caveat}" for caveat in caveats) if caveats else ""


def _tars(index: Mapping[str, Any], split: SplitName) -> list[str]:
    return [shard["tar"] for shard in index["shards"] if shard["split"] == split]


def _glob(index: Mapping[str, Any], split: SplitName) -> str:
    """Return a glob for the tars of a split, with the names' beginning: a config's name may contain a split's."""
    return f"{_tars(index, split)[0].rpartition('-')[0]}-*.tar"


def _braces(index: Mapping[str, Any], split: SplitName) -> str:
    """Return the tars of a split as one name with a range in braces, which the webdataset package expands."""
    tars = _tars(index, split)
    begin, _, first = tars[0].removesuffix(".tar").rpartition("-")
    last = tars[-1].removesuffix(".tar").rpartition("-")[2]
    return tars[0] if len(tars) == 1 else f"{begin}-{{{first}..{last}}}.tar"


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines)


def _escaped(text: str) -> str:
    """Return a text on one line without Markdown's meaning of its characters."""
    return re.sub(r"([\\`*_\[\]<>|#~$])", r"\\\1", " ".join(text.split()))


def _bytes(count: int) -> str:
    power = min((len(str(count)) - 1) // 3, len(_UNITS))
    return f"{count / 1000**power:.1f} {_UNITS[power - 1]}" if power else f"{count} B"
