"""The cost of augmenting a crop of 320 x 720 px, and the cores that feed a GPU with 8 of them 20 times a second.

    OMP_NUM_THREADS=1 python benchmarks/augmentation_costs.py > benchmarks/results/augmentation-costs.txt

The pair is in memory, 600 x 1280 px; reading or rendering it is not timed. Rows take turns, and figures are medians of
CPU time. torchvision's colours are timed beside them where it is installed.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median

import numpy as np

from semisynth_gl.augmentation import PRESETS, Augmentation
from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.channels import View
from semisynth_gl.frame.frame import Frame

SIDES, CROP = (600, 1280), (320, 720)
SAMPLES_A_SECOND = 8 * 20
TURNS = 40
RAFT = PRESETS["raft-stereo"]
COLOURS = Augmentation(
    brightness=RAFT.brightness, contrast=RAFT.contrast, saturation=RAFT.saturation, hue_turns=RAFT.hue_turns
)
ROWS = {
    "crop alone": Augmentation(),
    "colours": COLOURS,
    "noise": Augmentation(noise=(1, 4)),
    "blur": Augmentation(blur_px=(0.5, 1)),
    "JPEG": Augmentation(jpeg=1),
    "scale and stretch": Augmentation(scale=RAFT.scale, stretch=RAFT.stretch),
    "scale, stretch, right image moved": replace(RAFT, occluded=0, **{name: getattr(Augmentation(), name) for name in (
        "brightness", "contrast", "saturation", "hue_turns", "asymmetric"
    )}),
    "semisynth": PRESETS["semisynth"],
    "raft-stereo": RAFT,
}  # fmt: skip


def pair(*, both: bool) -> Frame:
    """Make a pair of noise on slanted planes, with truth of the left view or of both, and masks."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SIDES[0], : SIDES[1]]
    disparity = (20 + 0.05 * y + 40 * ((x // 80 + y // 60) % 2)).astype(np.float32)
    truth = {"disparity": disparity, "visibility": np.full(SIDES, 255, np.uint8)}
    views = [
        View({"image": rng.integers(0, 256, (*SIDES, 3), np.uint8), **(truth if both or left else {})})
        for left in (True, False)
    ]
    return Frame(StereoCamera.centred(SIDES[1], SIDES[0], 900.0, 0.2), *views)


def job(augmentation: Augmentation, whole: Frame) -> Callable[[int], None]:
    """Return what augments a sample by its number."""

    def run(number: int) -> None:
        drawn = augmentation.draw(CROP, SIDES, 0, number)
        height, width = drawn.source or SIDES
        drawn.applied(whole.cropped(Crop(20, 10, width, height)), augmentation.noise_rng(0, number))

    return run


def torchvision_colours() -> Callable[[int], None] | None:
    """Return a job that changes two images by torchvision's ColorJitter; None without torchvision."""
    try:
        import torch  # noqa: PLC0415 - optional
        from torchvision.transforms import v2  # noqa: PLC0415 - optional
    except ImportError:
        return None
    images = torch.randint(0, 256, (2, 3, *CROP), dtype=torch.uint8)
    jitter = v2.ColorJitter(0.4, 0.4, (0, 1.4), 0.159)
    return lambda _: jitter(images)


def main() -> None:
    """Print the table."""
    jobs = {}
    for truth, both in (("left", False), ("both", True)):
        whole = pair(both=both)
        jobs |= {(name, truth): job(augmentation, whole) for name, augmentation in ROWS.items()}
    beside = torchvision_colours()
    if beside is not None:
        jobs["torchvision's ColorJitter, uint8", "-"] = beside
    times: dict[tuple[str, str], list[float]] = {key: [] for key in jobs}
    for number in range(TURNS + 2):
        for key, run in jobs.items():
            start = time.process_time()
            run(number)
            if number >= 2:
                times[key].append(time.process_time() - start)
    rows = [
        [name, truth, f"{1e3 * median(taken):.1f}", f"{median(taken) * SAMPLES_A_SECOND:.1f}"]
        for (name, truth), taken in times.items()
    ]
    sys.stdout.write(
        markdown(["what", "truth of", "ms a sample", "cores"], rows)
        + f"\n\n{machine_facts()['processor']}, one thread\n"
    )


if __name__ == "__main__":
    main()
