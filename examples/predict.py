"""Predict disparities of photographed pairs with a network that train.py trained.

    python examples/predict.py out/network/checkpoint.ckpt --left lab/left --right lab/right --out predictions

`semisynth-gl evaluate --pred` takes what is written.
"""

import sys
from pathlib import Path

import click
import numpy as np
import torch
from PIL import Image
from torch import Tensor
from train import StereoModule

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.textures.image_files import find_images


@click.command(context_settings={"help_option_names": ["-h", "--help"], "show_default": True, "max_content_width": 100})
@click.argument("checkpoint", type=click.Path(path_type=Path, exists=True))
@click.option("--network", default="stereo_network:StereoNetwork", help="As it was trained.")
@click.option("--left", required=True, help="The left images: a file, a folder, or a glob in quotes.")
@click.option("--right", required=True, help="The right images: as many, in the same order when sorted by path.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for NAME.pfm, float32 px.")
@click.option("--right-out", type=click.Path(path_type=Path), help="Predict the right views too, into this folder.")
@click.option("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="PyTorch's name.")
def main(checkpoint: Path, network: str, left: str, right: str, out: Path, right_out: Path | None, device: str) -> None:
    """Predict the disparity of pairs, each named like its left image, or its folder where images share a name."""
    try:
        run(load(checkpoint, network).to(device), left, right, out, right_out)
    except (SemisynthError, OSError) as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)


def load(checkpoint: Path, network: str) -> StereoModule:
    """Make the network, and give it the weights of a checkpoint.

    Raises:
        InputError: where the checkpoint is another network's.
    """
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    trained = state["hyper_parameters"]
    # Which code runs is for the caller to say: a checkpoint may be a stranger's.
    if trained["network"] != network:
        raise InputError(f"{checkpoint}: was trained with --network {trained['network']}: give that, if you trust it")
    module = StereoModule(**trained)
    module.load_state_dict(state["state_dict"])
    return module.eval()


def run(module: StereoModule, left: str, right: str, out: Path, right_out: Path | None) -> None:
    """Predict all pairs.

    Raises:
        InputError: where the images are not pairs.
    """
    lefts, rights = (find_images([where]) for where in (left, right))
    if len(lefts) != len(rights):
        raise InputError(f"--left, --right: expected as many images of each, got {len(lefts)} and {len(rights)}")
    names = [each.stem for each in lefts]
    if len({*names}) < len(names):
        names = [each.parent.name for each in lefts]
    if len({*names}) < len(names):
        raise InputError(f"--left {left}: images share names, and so do their folders: predict them one by one")
    for folder in filter(None, (out, right_out)):
        folder.mkdir(parents=True, exist_ok=True)
    for name, one, other in zip(names, lefts, rights, strict=True):
        images = [_read(path, module.device) for path in (one, other)]
        if images[0].shape != images[1].shape:
            raise InputError(f"{other}: has {tuple(images[1].shape[1:])} px, {one} {tuple(images[0].shape[1:])}")
        with torch.inference_mode():
            _write(out / f"{name}.pfm", module.predict_disparity(*images))
            if right_out is not None:
                # The right view of a pair is the left one of its mirror image.
                mirrored = module.predict_disparity(images[1].flip(-1), images[0].flip(-1))
                _write(right_out / f"{name}.pfm", mirrored.flip(-1))
        click.echo(name)


def _read(path: Path, device: torch.device) -> Tensor:
    return torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1).to(device)


def _write(path: Path, disparity: Tensor) -> None:
    path.write_bytes(PFM.encode(disparity.cpu().numpy()))


if __name__ == "__main__":
    main()
