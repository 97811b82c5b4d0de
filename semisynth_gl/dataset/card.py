"""The dataset card: a README.md with the front matter that hubs read. Its template is assets/card.md.jinja."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from math import isfinite
from typing import Any

from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from semisynth_gl.config.yaml_values import write_yaml
from semisynth_gl.dataset.begun import plan_of
from semisynth_gl.dataset.documents import IndexDocument
from semisynth_gl.dataset.file_sets import FileSet, list_file_sets
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.frame.channels import FLOW_OUTPUTS
from semisynth_gl.inputs.errors import counted
from semisynth_gl.inputs.templates import template_environment
from semisynth_gl.plugins import NOUNS
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.sources import describe_source

# The names in the documentation of Hugging Face's hub; any other licence becomes "other" with a name.
_LICENCES = frozenset(
    """
    apache-2.0 mit openrail bigscience-openrail-m creativeml-openrail-m bigscience-bloom-rail-1.0 bigcode-openrail-m
    afl-3.0 artistic-2.0 bsl-1.0 bsd bsd-2-clause bsd-3-clause bsd-3-clause-clear c-uda cc cc0-1.0 cc-by-2.0 cc-by-2.5
    cc-by-3.0 cc-by-4.0 cc-by-sa-3.0 cc-by-sa-4.0 cc-by-nc-2.0 cc-by-nc-3.0 cc-by-nc-4.0 cc-by-nd-4.0 cc-by-nc-nd-3.0
    cc-by-nc-nd-4.0 cc-by-nc-sa-2.0 cc-by-nc-sa-3.0 cc-by-nc-sa-4.0 cdla-sharing-1.0 cdla-permissive-1.0
    cdla-permissive-2.0 wtfpl ecl-2.0 epl-1.0 epl-2.0 etalab-2.0 eupl-1.1 agpl-3.0 gfdl gpl gpl-2.0 gpl-3.0 lgpl
    lgpl-2.1 lgpl-3.0 isc lppl-1.3c ms-pl mpl-2.0 odc-by odbl openrail++ osl-3.0 postgresql ofl-1.1 ncsa unlicense zlib
    pddl lgpl-lr unknown other
    """.split()  # noqa: SIM905 - a long list reads better without quotes
)
_SIZE_NAMES = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
_UNITS = ("kB", "MB", "GB", "TB")
# Endings of the images that the package datasets finds in folders and Pillow opens.
_IMAGE_ENDINGS = (".png", ".jpg")
_MAIN_ROLE = "left"


def encode_card(index: IndexDocument) -> bytes:
    """Encode a dataset's README.md from its index: YAML between two lines of dashes, then Markdown."""
    plan = plan_of(index)
    environment = template_environment()
    environment.filters |= {"bytes": _bytes, "counted": counted, "one_line": _one_line, "plain": _escaped}
    environment.tests["finite"] = isfinite
    baselines = [range_m for each in plan.config.recipes() for range_m in each.config.camera.baseline_ranges_m]
    tars = {split: _tars(index, split) for split in plan.splits} if plan.layout.packed else {}
    body = environment.get_template("card.md.jinja").render(
        plan=plan,
        index=index,
        source=describe_source(plan.config.textures.source),
        baseline_ends_m=(min(each.low for each in baselines), max(each.high for each in baselines)),
        tars=tars,
        data_files=json.dumps({split: glob for split, (glob, _) in tars.items()}),
        **_loadable(plan),
        moving=_has_flow(plan),
        nouns=NOUNS,
        rights=_rights(plan, index),
        linked=plan.layout.folders() or any(plan.layout.links([plan.key(split, 0)]) for split in plan.splits),
    )
    return f"---\n{_front(plan, index)}---\n\n{body}".encode()


def _front(plan: Plan, index: IndexDocument) -> str:
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
        files = [{"split": split, "path": _quoted(_tars(index, split)[0])} for split in plan.splits]
        values["configs"] = [{"config_name": "default", "data_files": files}]
    else:
        values["configs"] = [_config(role, file_sets) for role, file_sets in _image_sets(plan).items()]
    return write_yaml(values)


def _config(role: str, file_sets: Sequence[FileSet]) -> dict[str, Any]:
    """Return the hub's config for a role's images; without configs, hubs load any file, such as shards' records."""
    return {
        "config_name": role,
        **({"default": True} if role == _MAIN_ROLE else {}),
        "data_files": [{"split": each.split, "path": _quoted(each.pattern)} for each in file_sets],
        "drop_labels": True,  # else the folders' names become classes
    }


def _image_sets(plan: Plan) -> dict[str, list[FileSet]]:
    """Return the file sets that hubs show as images, by role, one for each split; left images in any format."""
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
    # Hubs read YAML 1.1, in which more unquoted texts are numbers, dates or truth values than in YAML 1.2.
    quoted: str = DoubleQuotedScalarString(text)
    return quoted


def _size_category(pairs: int) -> str:
    lower = ""
    for power, name in enumerate(_SIZE_NAMES, 3):
        if pairs < 10**power:
            return f"{lower}n<{name}"
        lower = f"{name}<"
    return f"n>{_SIZE_NAMES[-1]}"


def _tars(index: IndexDocument, split: SplitName) -> tuple[str, str]:
    """Return a glob for the tars of a split, and their range in braces, which the webdataset package expands.

    Both keep the whole beginning of the names, since a config's name may contain the name of another split.
    """
    tars = [shard.tar.removesuffix(".tar") for shard in index.shards if shard.split == split and shard.tar is not None]
    (begin, _, first), last = tars[0].rpartition("-"), tars[-1].rpartition("-")[2]
    return f"{begin}-*.tar", f"{begin}-{first if first == last else f'{{{first}..{last}}}'}.tar"


def _loadable(plan: Plan) -> dict[str, Any]:
    """Return the roles that the package datasets loads from folders, and all other roles by codec description."""
    images = [role for role, (first, *_) in _image_sets(plan).items() if first.pattern.endswith(_IMAGE_ENDINGS)]
    others: dict[str, list[str]] = {}
    for each in list_file_sets(plan, plan.splits[0]):
        if each.role not in images:
            others.setdefault(each.codec.description, []).append(each.role)
    return {"images": images, "others": others}


def _rights(plan: Plan, index: IndexDocument) -> list[tuple[str, str]]:
    """Return the counts of photographs and of models, as text, each with its licence."""
    rows: list[tuple[str, str]] = []
    photographs = describe_source(plan.config.textures.source).noun
    for noun, key in ((photographs, "photographs"), ("kind of model", "models")):
        named = {(item.name, item.licence) for split in index.splits.values() for item in getattr(split, key)}
        counts = Counter(licence for _, licence in named)
        rows += [(counted(count, noun), licence) for licence, count in sorted(counts.items())]
    return rows


def _has_flow(plan: Plan) -> bool:
    return not FLOW_OUTPUTS.isdisjoint(plan.config.outputs)


def _escaped(text: str) -> str:
    """Return a text on one line, with Markdown's special characters escaped."""
    return re.sub(r"([\\`*_\[\]<>|#~$])", r"\\\1", _one_line(text))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _bytes(count: int) -> str:
    power = min((len(str(count)) - 1) // 3, len(_UNITS))
    return f"{count / 1000**power:.1f} {_UNITS[power - 1]}" if power else f"{count} B"
