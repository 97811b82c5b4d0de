"""Make a small dataset of every packaged config, layout, encoding and output, and print a SHA-256 for each.

Run it before and after a change that must not change any dataset, with the same driver:

    python benchmarks/dataset_digests.py > before.txt
    python benchmarks/dataset_digests.py --compare before.txt

Each line has a name and two digests. The first digest covers names and contents of the pairs' files, lists and links.
The second digest covers index, card and records, which may name versions. Neither covers the shards' logs, which
contain times.

With --compare, a line for each dataset says whether its files are the same. The exit code is 1 if the pairs of a
dataset differ, or if only one of the two runs has the dataset.
"""

import argparse
import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from semisynth_gl.config.load import packaged_configs
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.plugins import BUILT_IN

REAL_RIG = Path(__file__).resolve().parents[1] / "examples" / "real-rig.yaml"
# Layouts in which the config chooses the encodings.
FREE_LAYOUTS = ("middlebury", "webdataset")
ENCODINGS = (("png", "pfm", "flo"), ("png", "png16", "pfm"), ("png", "pfm", "png16"))
DESCRIPTIONS = ("index.json", "README.md")
SMALL = ("--set", "camera.width_px=226", "--set", "camera.height_px=141", "--set", "textures.max_patches=64")
# The layout has files for every output.
ETH3D = ("--config", "eth3d", "--pairs", "2", "--layout", "middlebury")
# Some layouts have no files for these outputs, so they have separate cases.
OF_LENSES = ("valid", "raw", "raw_map")
OF_RIGS = ("correspondence", "sky", *OF_LENSES)
MOVING = (
    *("--outputs", ",".join(output for output in OUTPUTS if output not in OF_RIGS), "--set", "sequence.length=2"),
    *("--set", "camera.sway_m=[0.01,0.05]", "--set", "camera.sway_deg=[0.5,2]"),
    *("--set", "structures.ground=0.5", "--set", "structures.panels=[1,3]"),
)
SKY = ("background.street=1", "background.cuboid=0", "background.room=0", "background.sky=1", "disparity.signed=true",
       "camera.doffs_px=8", "files.disparity=png16", "scenes=[]")  # fmt: skip
NOISE = ("--set", "imperfections.noise=[1,4]", "--set", "imperfections.gamma=[0.9,1.1]", "--set",
         "imperfections.blur_px=[0,1]", "--set", "imperfections.exposure_stops=[-0.2,0.2]")  # fmt: skip


_EYE = "{fx_px: 600, distortion: [-0.3, 0.1, 0, 0], rotation_deg: [0.2, [-1, 1], 0.5]}"
LENS = ("--set", f"lens={{raw_width_px: 940, raw_height_px: 490, left: {_EYE}, right: {_EYE}}}")
DEVIATING = ("--set", "rig.right_roll_deg=[-1,1]", "--set", "rig.right_pitch_deg=[-1,1]", "--set",
             "rig.right_y_px=[-3,3]", "--set", "rig.focal_ratio=[0.99,1.01]")  # fmt: skip


def cases() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the name of each dataset, and the options of `semisynth-gl generate` that make it."""
    for config in packaged_configs():
        yield f"config/{config}", ("--config", config, "--pairs", "2")
    for layout in BUILT_IN["layouts"]:
        moving = ("--config", "sceneflow", "--pairs", "4", "--layout", layout, *MOVING)
        yield f"layout/{layout}", moving
        splits = ("--validation", "1", "--test", "1", "--set", "splits.models=true")
        small = ("--config", "kitti", "--pairs", "3", "--layout", layout, "--shard-pairs", "2")
        yield f"splits/{layout}", (*small, *splits)
    for layout in FREE_LAYOUTS:
        for image, disparity, flow in ENCODINGS:
            files = [f"files.image={image}", f"files.disparity={disparity}", f"files.flow={flow}"]
            options = [option for value in files for option in ("--set", value)]
            moving = ("--config", "middlebury", "--pairs", "2", "--layout", layout, *MOVING)
            yield f"encoding/{layout}/{image}-{disparity}-{flow}", (*moving, *options)
    for output in ("none", *OUTPUTS):
        sequence = (*ETH3D, "--set", "sequence.length=2", *(LENS if output in OF_LENSES else ()))
        yield f"output/{output}", (*sequence, "--outputs", output)
    for layout in (*FREE_LAYOUTS, "middlebury-2014"):
        rig = ("--config", "sceneflow", "--pairs", "2", "--layout", layout, "--outputs", "visibility,correspondence")
        yield f"rig/{layout}", (*rig, *DEVIATING)
    sky = [option for value in SKY for option in ("--set", value)]
    yield "sky", ("--config", "eth3d", "--pairs", "2", "--layout", "webdataset", *MOVING, *sky)
    left = (*ETH3D, "--set", "truth=left")
    yield "truth/left", (*left, "--outputs", "visibility,instances,depth")
    for antialias in ("edges", "ssaa2"):
        yield f"antialias/{antialias}", (*ETH3D, "--set", f"antialias={antialias}")
    yield "anisotropy", (*ETH3D, "--set", "textures.anisotropy=4")
    yield "imperfections", (*ETH3D, *NOISE)
    dense = ("--set", "particles.density=dense", "--set", "textures.min_texture=4", "--set", "textures.wrap=repeat")
    yield "dense", ("--config", "kitti", "--pairs", "2", "--layout", "middlebury", *dense)
    yield "real-rig", ("--config", str(REAL_RIG), "--pairs", "8")


def make_photographs(folder: Path) -> None:
    """Write three pictures of smooth noise for the configs that need the user's photographs."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for number in range(3):
        coarse = rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)
        fine = rng.integers(-40, 41, (640, 960, 3))
        picture = np.asarray(Image.fromarray(coarse).resize((960, 640), Image.Resampling.BICUBIC)) + fine
        Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(folder / f"{number}.png")


def digests(folder: Path) -> tuple[str, str]:
    """Return two digests of a dataset: of the files of its pairs, and of the files that describe it."""
    pairs, descriptions = hashlib.sha256(), hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            content = str(path.readlink()).encode()
        elif path.is_file() and not (name.startswith("shards/") and name.endswith(".log")):
            content = path.read_bytes()
        else:
            continue
        described = name in DESCRIPTIONS or (name.startswith("shards/") and name.endswith(".json"))
        digest = descriptions if described else pairs
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return pairs.hexdigest(), descriptions.hexdigest()


def make(name: str, options: Sequence[str], folder: Path) -> str:
    """Make a dataset in the folder of the photographs, and return its line."""
    out = folder / name.replace("/", "-")
    images = ("--images", "photographs") if name.endswith("textures-target") else ()
    command = [sys.executable, "-m", "semisynth_gl", "generate", *options, *images, *SMALL, "--workers", "1"]
    done = subprocess.run(
        [*command, "--out", out.name, "--seed", "3"], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{name}: {' '.join(command)}: exit code {done.returncode}\n{done.stderr}")
    return f"{name} {' '.join(digests(out))}"


def read_lines(path: Path) -> dict[str, list[str]]:
    """Read the lines of an earlier run: both digests of each dataset, by its name."""
    return {name: digests for name, *digests in map(str.split, path.read_text().splitlines())}


def main() -> None:
    """Print the lines; with --compare, compare each dataset, and exit with 1 if any differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compare", type=Path, metavar="FILE", help="lines of an earlier run")
    parser.add_argument("--only", default="", metavar="TEXT", help="datasets whose name contains this")
    arguments = parser.parse_args()
    before = read_lines(arguments.compare) if arguments.compare else {}
    # Datasets of only one run count as different.
    missing = [name for name in before if arguments.only in name and name not in dict(cases())]
    for name in missing:
        print(f"DIFFERENT, no longer made: {name}", flush=True)
    differing = len(missing)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        make_photographs(folder / "photographs")
        for name, options in cases():
            if arguments.only not in name:
                continue
            line = make(name, options, folder)
            if not arguments.compare:
                print(line, flush=True)
                continue
            if name not in before:
                differing += 1
                print(f"DIFFERENT, not made before: {name}", flush=True)
                continue
            earlier, now = before[name], line.split()[1:]
            differing += earlier[0] != now[0]
            about = "" if earlier[1] == now[1] else ", other descriptions"
            print(f"{'same' if earlier[0] == now[0] else 'DIFFERENT'}{about}: {name}", flush=True)
    if differing:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
