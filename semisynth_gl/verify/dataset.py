"""All checks of a dataset, scene after scene."""

from collections.abc import Iterator

from semisynth_gl.read.middlebury import Index, SceneFiles, read_scene_files
from semisynth_gl.verify.consistency import check_left_right, check_mask, match_views, one_surface, visible_pixels
from semisynth_gl.verify.disparity import check_calibration, check_depth, check_disparity, check_instances
from semisynth_gl.verify.files import check_index, check_pair, check_scene_folder, check_sizes
from semisynth_gl.verify.finding import DATASET, Verdict
from semisynth_gl.verify.photometry import check_images
from semisynth_gl.verify.recast import Recaster


def verify_dataset(index: Index, oracle_pixels: int = 0) -> Iterator[Verdict]:
    """Check a dataset.

    Args:
        index: the dataset, as `read_index` opened it.
        oracle_pixels: also make each scene again and cast rays at this many of its pixels.

    Yields:
        The verdict on the dataset as a whole, then one for each scene, in the index's order.

    Raises:
        InputError: where the oracle is asked for and the scenes cannot be made again.
    """
    recaster = Recaster(index) if oracle_pixels else None
    verdict = Verdict(DATASET)
    check_index(index, verdict)
    yield verdict
    for name in index.scenes:
        verdict = Verdict(name)
        if check_scene_folder(index, verdict):
            scene, faults = read_scene_files(index.scene_path(name), index.encodings)
            for fault in faults:
                verdict.add("files", f"{fault.path.name} {fault.reason}")
            if scene is not None:
                _check_scene(scene, index, verdict)
                pair = name.rpartition("-")[2]
                if recaster is not None and pair.isdecimal():
                    recaster.check(scene, int(pair), oracle_pixels, verdict)
        yield verdict


def _check_scene(scene: SceneFiles, index: Index, verdict: Verdict) -> None:
    check_pair(scene, index, verdict)
    check_calibration(scene, verdict)
    if not check_sizes(scene, index, verdict):
        # The checks that follow compare pixel with pixel.
        return
    check_disparity(scene, index.number("disparity", "max_px"), verdict)
    check_depth(scene, verdict)
    check_instances(scene, verdict)
    if scene.disparity_right is None:
        # What follows compares the views with each other.
        return
    left = match_views(scene.disparity_left, scene.disparity_right, -1)
    mask = scene.optional.get("mask0nocc.png")
    if mask is not None:
        check_mask("mask0nocc.png", mask, left, verdict)
    mask_right = scene.optional.get("mask1nocc.png")
    if mask_right is not None:
        right = match_views(scene.disparity_right, scene.disparity_left, +1)
        check_mask("mask1nocc.png", mask_right, right, verdict)
    visible = visible_pixels(left, mask)
    check_left_right(left, visible, verdict)
    check_images(scene.left, scene.right, left, one_surface(left, visible), verdict, imperfect=index.imperfect)
