"""Predict disparities of photographed pairs with a network that train_network.py trained.

    python examples/predict.py out/network/weights.pt --left lab/left --right lab/right --out predictions

`semisynth-gl evaluate --pred` takes what is written.
"""

import sys
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import torch
from network_form import LARGEST_MULTIPLE, Form, find_device, load_weights, read_state
from PIL import Image

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.textures.image_files import find_images

_REFUSED = 2


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.argument("weights", type=click.Path(path_type=Path), metavar="WEIGHTS.pt")
@click.option(
    "--left",
    required=True,
    metavar="PATH_OR_GLOB",
    help="The left images: a file, a folder, or a glob in quotes, such as 'lab/*/im0.png'.",
)
@click.option(
    "--right",
    required=True,
    metavar="PATH_OR_GLOB",
    help="The right images, likewise: as many, and in the same order when sorted by path.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder for NAME.pfm, float32 px."
)
@click.option(
    "--right-out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Predict the right views too, into this folder, for evaluate --pred-right.",
)
@click.option(
    "--multiple",
    type=click.IntRange(1, LARGEST_MULTIPLE),
    help="Pad images to sides that are multiples of this, px, such as 32.  [default: as it was trained]",
)
@click.option(
    "--device",
    type=click.Choice(("auto", "cpu", "cuda")),
    default="auto",
    show_default=True,
    help="auto takes a GPU where PyTorch finds one.",
)
def main(
    weights: Path, left: str, right: str, out: Path, right_out: Path | None, multiple: int | None, device: str
) -> None:
    """Predict the disparity of pairs, each named like its left image, or its folder where images share a name.

    WEIGHTS.pt is weights.pt of train_network.py, which says how to make the network.
    """
    try:
        run(weights, left, right, out, right_out, multiple, find_device(device))
    except (SemisynthError, OSError) as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(_REFUSED)


def run(
    weights: Path,
    left: str,
    right: str,
    out: Path,
    right_out: Path | None,
    multiple: int | None,
    device: torch.device,
) -> None:
    """Do what the options say; see ``--help``.

    Raises:
        InputError: where they cannot be followed.
        OSError: where a file cannot be read or written.
    """
    lefts, rights = (find_images([where]) for where in (left, right))
    if len(lefts) != len(rights):
        raise InputError(f"--left, --right: expected as many images of each, got {len(lefts)} and {len(rights)}")
    names = [each.stem for each in lefts]
    if len({*names}) < len(names):
        names = [each.parent.name for each in lefts]
    if len({*names}) < len(names):
        raise InputError(f"--left {left}: images share names, and so do their folders: predict them one by one")
    state = read_state(weights, device)
    if "form" not in state:
        raise InputError(f"{weights}: expected weights.pt of train_network.py, which says how to make the network")
    form = Form.of(state["form"])
    if multiple is not None:
        form = replace(form, multiple_px=multiple)
    network = form.make().to(device)
    load_weights(network, weights, device)
    for folder in filter(None, (out, right_out)):
        folder.mkdir(parents=True, exist_ok=True)
    for name, one, other in zip(names, lefts, rights, strict=True):
        images = [np.asarray(Image.open(path).convert("RGB")) for path in (one, other)]
        if images[0].shape != images[1].shape:
            raise InputError(f"{other}: has {images[1].shape[:2]} px, {one} {images[0].shape[:2]}: expected one size")
        (out / f"{name}.pfm").write_bytes(PFM.encode(form.predict(network, *images)))
        if right_out is not None:
            # The right view of a pair is the left one of its mirror image.
            mirrored = form.predict(network, images[1][:, ::-1], images[0][:, ::-1])
            (right_out / f"{name}.pfm").write_bytes(PFM.encode(mirrored[:, ::-1]))
        click.echo(name)


if __name__ == "__main__":
    main()
