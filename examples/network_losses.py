"""The losses that stereo networks are trained with, of whatever form a network's output has."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from semisynth_gl.inputs.errors import InputError, abbreviate

Loss = Callable[[Any, Tensor, float], Tensor]
"""From a network's output, the true disparity (B, H, W) px and the end of the searched range, px, to a number."""
_DECAY = 0.9
_DECAY_STEPS = 15
"""RAFT-Stereo's: over all estimates, weights fall by this factor as if there were so many steps between them."""
_WEIGHTS = (0.5, 0.7, 1.0)
"""PSMNet's, of its three estimates; earlier ones have the first."""


def estimates_of(output: Any) -> list[Tensor]:  # noqa: ANN401 - that is what it finds out
    """Return a network's estimates of the left disparity, each (B, H, W) px; the final one comes last.

    Args:
        output: a tensor (B, H, W) or (B, 1, H, W), a list or tuple of them, or an object with such ``disparities``.

    Raises:
        InputError: where it is something else.
    """
    output = getattr(output, "disparities", output)
    several = [output] if isinstance(output, Tensor) else output
    if not isinstance(several, (list, tuple)) or not several or not all(isinstance(each, Tensor) for each in several):
        raise InputError(
            f"gave {_kind(output)}: expected a tensor (B, H, W) or (B, 1, H, W) of left disparities, px, or a list of "
            "estimates with the best one last; wrap the network in a module that gives these"
        )
    flat = [each[:, 0] if each.ndim == 4 and each.shape[1] == 1 else each for each in several]
    sizes = [tuple(each.shape) for each in flat]
    if any(len(size) != 3 or size != sizes[-1] for size in sizes):
        raise InputError(f"gave disparities of the sizes {sizes}: expected (B, H, W), the images', each")
    return flat


def sequence_loss(output: Any, truth: Tensor, max_disparity: float) -> Tensor:  # noqa: ANN401 - as estimates_of
    """Mean absolute errors of all estimates, later ones weighing more; RAFT-Stereo's.

    Args:
        output: of a network, see `estimates_of`.
        truth: (B, H, W), px; pixels that are not finite, not positive, or not below max_disparity are left out.
        max_disparity: px.

    Returns:
        A number; 0 where there is no pixel to learn from.
    """
    estimates = estimates_of(output)
    decay = _DECAY ** (_DECAY_STEPS / max(1, len(estimates) - 1))
    weights = [decay ** (len(estimates) - 1 - i) for i in range(len(estimates))]
    return _weighted(functional.l1_loss, estimates, weights, *_usable(truth, max_disparity))


def smooth_l1_loss(output: Any, truth: Tensor, max_disparity: float) -> Tensor:  # noqa: ANN401 - as estimates_of
    """Mean smooth L1 of all estimates, weighted as PSMNet does; otherwise like `sequence_loss`."""
    estimates = estimates_of(output)
    weights = [_WEIGHTS[max(0, i)] for i in range(len(_WEIGHTS) - len(estimates), len(_WEIGHTS))]
    return _weighted(functional.smooth_l1_loss, estimates, weights, *_usable(truth, max_disparity))


def cross_entropy_loss(output: Any, truth: Tensor, max_disparity: float) -> Tensor:  # noqa: ANN401 - as estimates_of
    """`smooth_l1_loss`, and the cross-entropy of the scores of disparity levels.

    A mean over levels teaches slowly: where it is wrong, it does not say which level is the right one.

    Args:
        output: of a network, with ``disparities``, a number ``step_px`` and ``scores`` (B, D, H', W'): the higher, the
            likelier is a disparity of ``step_px`` D px in a square of ``step_px``. More rows and columns are left out.
        truth: as in `sequence_loss`.
        max_disparity: px.

    Raises:
        InputError: where there are no scores.
    """
    scores = getattr(output, "scores", None)
    if not isinstance(scores, Tensor):
        raise InputError(
            f"--loss cross-entropy: the network gave {type(output).__name__}, which has no scores: expected an object "
            "like Estimates in examples/stereo_network.py; or take --loss smooth-l1 or sequence"
        )
    step = getattr(output, "step_px", None)
    least = [-(-(side - step // 2) // step) for side in truth.shape[1:]] if isinstance(step, int) and step > 0 else []
    if not least or scores.ndim != 4 or any(side < few for side, few in zip(scores.shape[2:], least, strict=True)):
        raise InputError(
            f"--loss cross-entropy: the network gave scores {tuple(scores.shape)} with step_px {step}: expected "
            "(B, D, H / step_px, W / step_px), and a whole number of px from level to level"
        )
    filled, valid = _usable(truth, max_disparity)
    return smooth_l1_loss(output, truth, max_disparity) + _cross_entropy(scores, step, filled, valid)


LOSSES: Mapping[str, Loss] = {
    "cross-entropy": cross_entropy_loss,
    "smooth-l1": smooth_l1_loss,
    "sequence": sequence_loss,
}


def _kind(output: Any) -> str:  # noqa: ANN401 - any output
    """Return what an output is, with what it holds."""
    if isinstance(output, Mapping):
        return f"a {type(output).__name__} with the keys {abbreviate([str(key) for key in output])}"
    if isinstance(output, (list, tuple)):
        return f"a {type(output).__name__} of {abbreviate([type(each).__name__ for each in output]) or 'nothing'}"
    return type(output).__name__


def _usable(truth: Tensor, max_disparity: float) -> tuple[Tensor, Tensor]:
    """Return the truth with 0 where it cannot be learnt from, and where it can."""
    valid = torch.isfinite(truth) & (truth > 0) & (truth < max_disparity)
    return torch.where(valid, truth, 0), valid


def _weighted(
    error: Callable[..., Tensor], estimates: list[Tensor], weights: list[float], truth: Tensor, valid: Tensor
) -> Tensor:
    pixels = valid.sum().clamp(min=1)
    loss = truth.new_zeros(())
    for estimate, weight in zip(estimates, weights, strict=True):
        # Left-out pixels are set equal before they are compared: infinite ones make gradients NaN, though weighted 0.
        compared = torch.where(valid, estimate.float(), 0)
        loss = loss + weight * error(compared, truth, reduction="sum") / pixels
    return loss


def _cross_entropy(scores: Tensor, step: int, truth: Tensor, valid: Tensor) -> Tensor:
    """Compare scores (B, D, H/step, W/step) with truth (B, H, W) px, which counts for the levels on both its sides."""
    # The pixel next to the middle of each square: a mean would mix what lies before and behind an edge.
    truth, valid = (each[:, step // 2 :: step, step // 2 :: step] for each in (truth, valid))
    height, width = truth.shape[1:]
    shares = scores[..., :height, :width].float().log_softmax(1)
    level = (truth / step).clamp(max=scores.shape[1] - 1)
    low = level.floor().long()
    high = (low + 1).clamp(max=scores.shape[1] - 1)
    found_low, found_high = (shares.gather(1, each[:, None])[:, 0] for each in (low, high))
    missed = -torch.lerp(found_low, found_high, level - low)
    return torch.where(valid, missed, 0).sum() / valid.sum().clamp(min=1)
