"""Clean sequences have no finding, and verify finds each fault planted in flow or change of disparity."""

import shutil

import numpy as np
import pytest
from planted_faults import at_pixel, change_file, change_json, checks, findings, swap
from tiny_datasets import SCENES, tiny, verified

from semisynth_gl.codecs import FLOW_CODECS
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE, ViewArrays
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.judge.single_view import check_view

# Much motion: a swaying camera, and models that fall, drift and spin.
SEQUENCE = {
    "sequence": {"length": 3, "frame_s": 0.1},
    "camera": {"sway_m": [0.05, 0.1], "sway_deg": [4.0, 6.0], "sway_s": [0.8, 1.2]},
    # Stated counts need no solver, and few patches are fast to cut.
    "particles": {
        "layers": [
            {"disparity_px": [1, 4], "count": [60, 80]},
            {"disparity_px": [4, 12], "count": [25, 35]},
            {"disparity_px": [12, 30], "count": [3, 6]},
        ]
    },
    "textures": {"max_patches": 64},
}
FLOWS = ("flow", "flow_backward", "disparity_change")
SUFFIXES = {"flo": ".flo", "pfm": ".pfm", "png16": ".png"}


def make(out, pairs=3, layout=None, outputs=("visibility", *FLOWS), truth="both", **sections):
    config = tiny("sceneflow", **SEQUENCE, **sections)
    generate(config.model_copy(update={"outputs": outputs, "truth": truth}), out, pairs, 0, layout=layout)
    return out


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    """Write a sequence of three frames in each encoding of flow."""
    root = tmp_path_factory.mktemp("datasets")
    for encoding in SUFFIXES:
        make(root / encoding, files={"flow": encoding})
    return root


@pytest.fixture
def copy(datasets, tmp_path):
    """Return a function that copies the dataset of an encoding, for planting faults."""
    return lambda encoding="flo": shutil.copytree(datasets / encoding, tmp_path / encoding, symlinks=True)


def scene(root, number=0):
    return root / SCENES / f"sceneflow-{number:06d}"


def flow_path(root, name, number=0):
    return scene(root, number) / f"{name}{SUFFIXES[root.name]}"


@pytest.mark.parametrize("encoding", SUFFIXES)
def test_a_clean_sequence_has_no_finding(datasets, encoding):
    found = verified(datasets / encoding, 200)
    assert found.findings == []
    _, *pairs = found.all_results
    allowed = 1e-2 if encoding == "png16" else 2e-3
    # The first frame has no previous frame.
    assert ["flow_left_frames_median_px" in results.measures for results in pairs] == [False, True, True]
    for results in pairs:
        assert results.measures["oracle_flow_largest_px"] < allowed
        assert results.measures["oracle_disparity_change_largest_px"] < 1e-3
    for results in pairs[1:]:
        for name in ("flow_left", "flow_right", "flow_backward_left", "flow_backward_right"):
            assert results.measures[f"{name}_frames_median_px"] < allowed
            assert results.measures[f"{name}_change_median_px"] < 2e-3
            assert results.measures[f"{name}_frames_outside_share"] < 0.005
            assert results.measures[f"{name}_image_explained"] > 0.95
            assert abs(results.measures[f"{name}_best_shift_x_px"]) < 0.1
        assert results.measures["flow_visibility_left_disagree_share"] < 0.005


@pytest.mark.parametrize("layout", ["kitti", "webdataset"])
def test_a_clean_sequence_of_another_layout_has_no_finding(tmp_path, layout):
    assert verified(make(tmp_path / "set", pairs=2, layout=layout)).findings == []


@pytest.mark.parametrize("outputs", [("flow",), ("flow_backward", "disparity_change")])
def test_a_part_of_the_outputs_is_judged_alone(tmp_path, outputs):
    dataset = make(tmp_path / "set", pairs=2, outputs=outputs, truth="left")
    assert verified(dataset, 20).findings == []


CHANGES = {
    "times 1.01": lambda flow: flow * 1.01,
    "u 0.1 px more": lambda flow: flow + np.array([0.1, 0]),
    "v 0.1 px more": lambda flow: flow + np.array([0, 0.1]),
    "the sign of v flipped": lambda flow: flow * np.array([1, -1]),
    "u and v swapped": lambda flow: flow[..., ::-1],
    "rows flipped": lambda flow: flow[::-1],
}


def flow(change, *names, number=0):
    def plant(root):
        for name in names:
            change_file(flow_path(root, name, number), change, FLOW_CODECS[root.name])

    return plant


def changed(change, *names, number=1):
    def plant(root):
        for name in names:
            change_file(scene(root, number) / name, change)

    return plant


def copied(source, target, *names):
    def plant(root):
        for name in names:
            shutil.copy(scene(root, source) / name, scene(root, target) / name)

    return plant


def backward_for_forward(root):
    for view in (0, 1):
        shutil.copy(flow_path(root, f"flow_backward{view}", 1), flow_path(root, f"flow{view}", 1))
        shutil.copy(scene(root, 1) / f"flow_backward_mask{view}.png", scene(root, 1) / f"flow_mask{view}.png")


CHANGE0, CHANGE1 = "disparity_change0.pfm", "disparity_change1.pfm"
FLOW_FILES = ("flow0.flo", "flow1.flo", "flow_mask0.png", "flow_mask1.png")
AT = "in 1 pixel, the first at (50, 40)"
FAULTS = {
    # The change, the check that finds it, and words of the message. Names begin with the encoding unless it is flo.
    **{
        f"{name} in {len(names)} views": (flow(change, *names), "flow-frames", "flow_left of sceneflow-000000")
        for name, change in CHANGES.items()
        for names in (("flow0",), ("flow0", "flow1"))
    },
    **{
        f"png16 {name}": (flow(CHANGES[name], "flow0", "flow1"), "flow-frames", "flow_right of")
        for name in ("times 1.01", "rows flipped")
    },
    "backward flow": (
        flow(CHANGES["times 1.01"], "flow_backward0", "flow_backward1", number=2),
        "flow-frames",
        "flow_backward_right of sceneflow-000002",
    ),
    "swapped views": (
        lambda root: swap(scene(root), ("flow0.flo", "flow1.flo"), ("flow_mask0.png", "flow_mask1.png")),
        "flow-frames",
        "",
    ),
    "another frame": (copied(1, 0, *FLOW_FILES), "flow-frames", ""),
    "another frame's image": (copied(1, 0, *FLOW_FILES), "flow-images", ""),
    "backward for forward": (backward_for_forward, "flow-images", ""),
    "the next frame's images": (copied(1, 0, "im0.png", "im1.png"), "flow-images", "flow_left of sceneflow-000000"),
    "negated change": (
        changed(lambda change: np.where(np.isfinite(change), -change, change), CHANGE0, CHANGE1),
        "disparity_change",
        "disparity_change_left by flow_left of sceneflow-000001",
    ),
    "change of one view": (
        changed(lambda change: change + np.float32(0.02), CHANGE1),
        "disparity_change",
        "disparity_change_right by flow_right of sceneflow-000001",
    ),
    "mask of the other direction": (
        lambda root: shutil.copy(scene(root, 1) / "flow_backward_mask0.png", scene(root, 1) / "flow_mask0.png"),
        "flow_visibility",
        "",
    ),
    "all visible": (
        changed(lambda mask: np.full_like(mask, VISIBLE), "flow_mask0.png"),
        "flow_visibility",
        "is not 0 for a point outside the image",
    ),
    "all occluded": (
        changed(lambda mask: np.full_like(mask, OCCLUDED), "flow_mask1.png"),
        "flow_visibility",
        "pixels that are visible have a different value",
    ),
    "nothing occluded": (
        changed(lambda mask: np.where(mask == OCCLUDED, VISIBLE, mask).astype(np.uint8), "flow_backward_mask0.png"),
        "flow_backward_visibility",
        "pixels that are occluded have a different value",
    ),
    "all outside": (
        changed(lambda mask: np.full_like(mask, OUTSIDE), "flow_backward_mask1.png"),
        "flow_backward_visibility",
        "is 0 for a point in the image",
    ),
    "mask of other values": (changed(lambda mask: mask // 2, "flow_mask0.png"), "flow_visibility", "is not one of"),
    "pfm NaN": (flow(at_pixel(40, 50, (np.nan, 1)), "flow0"), "files", "got NaN"),
    "pfm -inf": (flow(at_pixel(40, 50, (-np.inf, -np.inf)), "flow1"), "flow", f"flow_right is NaN or -inf {AT}"),
    "pfm inf in one component": (
        flow(at_pixel(40, 50, (np.inf, 1)), "flow_backward0", number=1),
        "flow_backward",
        f"flow_backward_left is inf in only one component {AT}",
    ),
    "a pixel without flow": (flow(at_pixel(40, 50, np.inf), "flow0"), "flow_visibility", f"is not 0 without flow {AT}"),
    "change without flow": (
        flow(at_pixel(40, 50, np.inf), "flow0"),
        "disparity_change",
        f"is finite without flow {AT}",
    ),
    "change without disparity": (
        changed(at_pixel(40, 50, np.inf), "disp0GT.pfm"),
        "disparity_change",
        f"is finite without a disparity {AT}",
    ),
    **{
        f"a change of {value}": (changed(at_pixel(40, 50, value), CHANGE1), "disparity_change", f"{words} {AT}")
        for value, words in (
            (np.nan, "is NaN or -inf"),
            (np.inf, "is inf"),
            (-1e3, "leads to an impossible disparity"),
            (1e3, "leads to an impossible disparity"),
        )
    },
    "png16 flow beyond the encoding": (
        lambda root: change_json(scene(root) / "pair.json", lambda values: values["flow_beyond"].update(left=10**6)),
        "flow",
        "the provenance counts 1000000 beyond",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found(copy, fault):
    planted, check, words = FAULTS[fault]
    root = copy(next((encoding for encoding in SUFFIXES if fault.startswith(encoding)), "flo"))
    planted(root)
    found = findings(root)
    assert any(finding.check == check and words in finding.message for finding in found), found


@pytest.mark.parametrize("name", ["times 1.01", "u 0.1 px more"])
def test_flow_wrong_everywhere_alike_is_found_by_rays(copy, name):
    root, change = copy(), CHANGES[name]
    for number in range(3):
        flow(change, "flow0", "flow1", number=number)(root)
        flow(lambda flow: -change(-flow), "flow_backward0", "flow_backward1", number=number)(root)
        changed(lambda values: values * np.float32(1.2), CHANGE0, CHANGE1, number=number)(root)
    wrong = {finding.message.split(": ")[0] for finding in findings(root, 20) if finding.check == "oracle"}
    assert wrong == {f"{kind}_{view}" for kind in FLOWS for view in ("left", "right")}


def findings_with(channel, values):
    """Check a left view with these values of a channel, of a camera with doffs; return the findings."""
    channels = {"disparity": np.full((6, 8), 9, np.float32), "disparity_change": np.zeros((6, 8), np.float32)}
    image, flow = np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8, 2), np.float32)
    left = ViewArrays({"image": image, "flow": flow} | channels | {channel: values})
    results, camera = CheckResults("it"), StereoCamera.centred(8, 6, 10.0, 0.1, doffs_px=5.0)
    check_view(StoredFrame(camera, left, ViewArrays({"image": image})), "left", 20.0, results)
    return [str(finding) for finding in results.findings]


@pytest.mark.parametrize(("least", "wrong"), [(0.5, False), (3.0, True)])
def test_a_change_may_be_missing_where_disparities_pass_through_0(least, wrong):
    change = np.full((6, 8), least - 9, np.float32)
    change[2, 3] = np.inf
    fault = "it: disparity_change: disparity_change_left is inf in 1 pixel, the first at (3, 2)"
    assert findings_with("disparity_change", change) == [fault] * wrong


@pytest.mark.parametrize("channel", ["disparity", "disparity_change"])
def test_no_view_lacks_all_values_of_a_channel(channel):
    found = findings_with(channel, np.full((6, 8), np.inf, np.float32))
    assert f"it: {channel}: {channel}_left is inf in 48 pixels, the first at (0, 0)" in found


def test_only_readable_frames_of_one_sequence_are_compared(copy):
    root = copy()

    def compared():
        return ["flow_left_frames_median_px" in each.measures for each in verified(root).all_results][1:]

    for length, expected in ((1, [False, False, False]), (2, [False, True, False]), (3, [False, True, True])):
        change_json(root / "index.json", lambda values, n=length: values["config_values"]["sequence"].update(length=n))
        assert compared() == expected
    (scene(root, 1) / "im0.png").unlink()
    assert checks(root) == {"files"}
    assert compared() == [False, False, False]


@pytest.mark.parametrize(
    ("section", "change"), [("textures", {"sequence": True}), ("imperfections", {"noise": [1, 2]})]
)
def test_images_that_differ_by_design_are_not_compared(copy, section, change):
    root = copy()
    copied(0, 1, "im0.png", "im1.png")(root)
    assert "flow-images" in checks(root)
    change_json(root / "index.json", lambda index: index["config_values"][section].update(change))
    assert "flow-images" not in checks(root)
