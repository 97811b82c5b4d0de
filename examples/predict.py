"""Predict disparities of photographed pairs with a network that train.py trained.

    python examples/predict.py out/network/checkpoint.ckpt --left lab/left --right lab/right --out predictions

`semisynth-gl evaluate --pred predictions` evaluates them.
"""

from pathlib import Path
from pickle import UnpicklingError

import click
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from train import CONTEXT, Command, StereoModule

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.image_files import find_images


@click.command(cls=Command, context_settings=CONTEXT)
@click.argument("checkpoint", type=click.Path(path_type=Path, exists=True))
@click.option("--network", default="stereo_network:StereoNetwork", help="The --network of train.py.")
@click.option("--left", required=True, help="The left images: a file, a folder, or a glob in quotes.")
@click.option("--right", required=True, help="The right images, in the same order when sorted by path.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for NAME.pfm, float32 px.")
@click.option("--right-out", type=click.Path(path_type=Path), help="Folder for predictions of the right views.")
@click.option("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="PyTorch's name of the device.")
def main(checkpoint: Path, network: str, left: str, right: str, out: Path, right_out: Path | None, device: str) -> None:
    """Predict the disparity of pairs. NAME is that of the left image, or of its folder if images have equal names."""
    module = load(checkpoint, network).to(device)
    lefts, rights = (find_images([where]) for where in (left, right))
    if len(lefts) != len(rights):
        raise InputError(f"--left, --right: expected as many images of each, got {len(lefts)} and {len(rights)}")
    names = [each.stem for each in lefts]
    if len({*names}) < len(names):
        names = [each.parent.name for each in lefts]
    if len({*names}) < len(names):
        raise InputError(f"--left {left}: images have equal names, and so have their folders: predict them one by one")
    for folder in filter(None, (out, right_out)):
        folder.mkdir(parents=True, exist_ok=True)
    for name, *paths in zip(names, lefts, rights, strict=True):
        images = [torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1) for path in paths]
        if images[0].shape != images[1].shape:
            left_px, right_px = (tuple(image.shape[1:]) for image in images)
            raise InputError(f"{paths[1]}: has {right_px} px, {paths[0]} {left_px}")
        (out / f"{name}.pfm").write_bytes(PFM.encode(predict(module, *images)))
        if right_out is not None:
            # The right view is the left view of the mirrored pair.
            mirrored = predict(module, *(image.flip(-1) for image in images[::-1]))
            (right_out / f"{name}.pfm").write_bytes(PFM.encode(mirrored[:, ::-1]))
        click.echo(name)


def load(checkpoint: Path, network: str) -> StereoModule:
    """Make a network with the weights of a checkpoint, without running code that the checkpoint contains or names."""
    try:
        # Some releases of Lightning import modules that a checkpoint names.
        state = torch.load(checkpoint, map_location="cpu", weights_only=True)
        module = StereoModule(**state["hyper_parameters"] | {"network": network})
        module.load_state_dict(state["state_dict"])
    except (UnpicklingError, EOFError, LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise InputError(f"{checkpoint}: expected a checkpoint of train.py with --network {network}: {error}") from None
    return module.eval()


def predict(module: StereoModule, left: Tensor, right: Tensor) -> NDArray[np.float32]:
    """Return the left disparity (H, W), px, of images (3, H, W) uint8."""
    with torch.inference_mode():
        return module.predict_disparity(left.to(module.device), right.to(module.device)).cpu().numpy()


if __name__ == "__main__":
    main()
