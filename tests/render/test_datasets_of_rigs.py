"""Datasets with deviating cameras, several baselines, lenses, skies, signed disparities and projectors."""

import json
from dataclasses import replace

import numpy as np
import pytest
from planted_faults import change_file, change_json, checks, findings
from recorder import Recorder
from test_rigs import ROOT, SEVERAL, open_scenes, several
from tiny_datasets import cheap, digests, verified, with_lens

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.codecs.png16 import SIGNED_DISPARITY
from semisynth_gl.config import load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.camera import RECTIFIED
from semisynth_gl.frame.channels import SKY
from semisynth_gl.judge.evaluate import evaluate
from semisynth_gl.judge.protocol import PROTOCOLS
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.plugins import BUILT_IN

SEED = 3
RIG = {"right_roll_deg": [-1, 1], "right_pitch_deg": [-1, 1], "right_y_px": [-2, 2], "focal_ratio": [0.99, 1.01]}
RATIO = {"camera": {"fy_over_fx": 1.02}}
OUTPUTS = ["visibility", "correspondence", "depth", "normals", "instances"]
MOVING = {"sequence.length": 2, "camera.sway_m": 0.04, "camera.sway_deg": 1.5}
OF_SKY = "visibility", "instances", "depth", "sky", "normals", "flow", "flow_backward", "disparity_change"


def twin(**imperfections):
    return cheap(
        rig={**RIG, "twin": True},
        outputs=OUTPUTS,
        camera={"baselines": 2, "baseline_m": [0.5, 1.0], "sway_m": 0.02},
        sequence={"length": 2},
        imperfections=imperfections,
    )


def real_rig():
    small = ["scale=0.2", "textures.source=procedural", "textures.max_patches=8", "textures.large_px=0"]
    # Dots at least as large as a pixel of these small images.
    few = ["models.complex=0", "models.variants=1", "projector.size_px=12"]
    return load_config(ROOT / "examples" / "real-rig.yaml", [*small, *few])


KINDS = {
    "deviating": (lambda: cheap(rig=RIG, outputs=OUTPUTS), "middlebury"),
    "deviating, tar": (lambda: cheap(rig=RIG, outputs=OUTPUTS), "webdataset"),
    "twins": (twin, "middlebury-2014"),
    "twins, noise": (lambda: twin(noise=2, motion_blur=0.5, sub_frames=3), "middlebury"),
    "baselines": (
        lambda: several(sequence={"length": 2, "frame_s": 0.1}, outputs=["visibility", "depth", "flow"]),
        "sceneflow",
    ),
    **{f"fx != fy, {layout}": (lambda: cheap(**RATIO), layout) for layout in BUILT_IN["layouts"]},
    "fx != fy, deviating": (
        lambda: cheap(**RATIO, rig=RIG, outputs=["visibility", "correspondence", "flow"], sequence={"length": 2}),
        "middlebury",
    ),
    "fx != fy, lens": (lambda: with_lens(**RATIO, outputs=["visibility", "valid", "raw", "raw_map"]), "middlebury"),
    "signed, sky": (lambda: open_scenes(6.5, 1.0, outputs=OF_SKY, more=MOVING), "webdataset"),
    "sky": (lambda: open_scenes(0.0, 1.0, signed=False, outputs=("sky", "normals")), "webdataset"),
    # No output marks the sky, so verify cannot check it.
    "untold sky": (lambda: open_scenes(0.0, 1.0, signed=False, outputs=("normals",)), "middlebury"),
    "real rig": (real_rig, "middlebury"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_datasets_are_what_was_drawn_and_nothing_is_found(tmp_path, kind):
    (make, layout), pairs = KINDS[kind], 4
    if "lens" in kind:
        pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")
    config = make()
    generate(config, tmp_path / "out", pairs, SEED, layout=layout)
    assert checks(tmp_path / "out", rays=100) == set()
    stored = list(open_dataset(tmp_path / "out"))
    assert len(stored) == pairs
    with PairRenderer(config, SEED) as renderer:
        for index in (3, 0, 1):
            made, pair = renderer.render(index), stored[index]
            assert pair.camera == made.frame.camera
            assert pair.provenance == json.loads(json.dumps(made.provenance)) | pair.provenance
            for role, array in made.frame.arrays().items():
                if role in pair.arrays() and layout not in ("kitti", "crestereo"):  # which round disparities
                    np.testing.assert_array_equal(pair.arrays()[role], array, err_msg=role)
                elif role.startswith("disparity"):
                    atol = pair.encodings.disparity.error_px
                    np.testing.assert_allclose(pair.arrays()[role], array, rtol=0, atol=atol, err_msg=role)
            assert {"left", "right"} <= pair.arrays().keys() <= made.frame.arrays().keys()
    if kind.startswith("fx != fy, ") and layout in kind:
        pair = stored[0]
        points = pair.points("left")
        assert pair.camera.focal_y_px == pytest.approx(1.02 * 131.25, rel=1e-15)
        np.testing.assert_allclose(points[40, 30, 1] / points[40, 30, 2], (40 - pair.camera.cy_px) / 133.875, rtol=1e-6)


def test_a_rectified_twin_has_the_same_left_image_and_rows_of_its_own(tmp_path):
    assert twin().views == real_rig().views == 4
    generate(twin(), tmp_path / "out", 4, 1)
    pairs = list(open_dataset(tmp_path / "out"))
    for deviating, rectified in (pairs[:2], pairs[2:]):
        for pair in (deviating, rectified):
            np.testing.assert_array_equal(pair.left.image, pairs[0].left.image)
        assert not deviating.camera.rectified
        assert replace(deviating.camera, deviation=RECTIFIED) == rectified.camera
        assert not np.array_equal(deviating.right.image, rectified.right.image)
        assert not rectified.left.correspondence[..., 1].any()


FAULTS = {
    "down by a hundredth": ("correspondence0.flo", lambda way: way + np.float32([0, 0.01]), {"correspondence"}),
    "along by a hundredth": ("correspondence1.flo", lambda way: way + np.float32([0.01, 0]), {"correspondence"}),
    "a hole": ("correspondence0.flo", lambda way: np.where(way[..., :1] < np.median(way[..., 0]), np.inf, way),
               {"correspondence"}),
    "an image a row lower": ("im1.png", lambda image: np.roll(image, 1, axis=0), {"images"}),
    "all seen": ("mask0nocc.png", lambda mask: np.full_like(mask, 255), {"visibility"}),
}  # fmt: skip


def test_planted_faults_are_found(tmp_path):
    generate(cheap(rig=RIG, outputs=OUTPUTS, camera={"width_px": 96, "height_px": 64}), tmp_path / "out", 1, 1)
    for fault, (name, change, found) in FAULTS.items():
        path = next((tmp_path / "out").rglob(name))
        whole = path.read_bytes()
        change_file(path, change)
        assert found <= checks(tmp_path / "out"), fault
        path.write_bytes(whole)
    path = next((tmp_path / "out").rglob("pair.json"))
    text = path.read_text("utf-8")
    ratio = text.partition('"focal_ratio": ')[2].partition("}")[0]
    path.write_text(text.replace(ratio, str(float(ratio) * 1.001)), "utf-8")
    assert {"correspondence", "depth"} <= checks(tmp_path / "out")


def test_a_wrong_fy_is_found(tmp_path):
    generate(cheap(**RATIO), tmp_path / "out", 1, 1)
    (calib,), (record,) = (list((tmp_path / "out").rglob(name)) for name in ("calib.txt", "pair.json"))
    text, fy = calib.read_text(), repr(131.25 * 1.02)
    assert text.count(fy) == 2
    calib.write_text(text.replace(fy, repr(131.25 * 1.021)))
    assert checks(tmp_path / "out") == {"calib"}
    # If both agree on a wrong value, only the rays into the config's scene find it.
    change_json(record, lambda pair: pair["camera"].update(fy_over_fx=1.021))
    assert checks(tmp_path / "out") == set()
    assert checks(tmp_path / "out", rays=50) == {"oracle"}


def test_verify_finds_what_no_sky_has(tmp_path):
    config = open_scenes(6.5, 1.0, outputs=("sky", "instances", "depth"))
    generate(config, tmp_path / "data", 1, SEED, layout="middlebury")
    folder = next((tmp_path / "data/MiddEval3/trainingF").glob("*"))
    path, mask = folder / "disp0GT.pfm", folder / "sky0.png"
    whole, sky = path.read_bytes(), mask.read_bytes()
    disparity = PFM.decode(whole, path)
    for wrong, found in ((-6.0, {"depth"}), (-9.0, {"disparity"}), (np.inf, {"disparity"})):
        path.write_bytes(PFM.encode(np.where(disparity == np.float32(-6.5), np.float32(wrong), disparity)))
        assert found <= checks(tmp_path / "data"), wrong
    path.write_bytes(whole)
    for values in (np.zeros_like(disparity, np.uint8), GREY8.decode(sky, mask) // 2):
        mask.write_bytes(GREY8.encode(values))
        assert {"sky", "oracle"} <= checks(tmp_path / "data", 200)


def test_signed_datasets_are_evaluated_beyond_0(tmp_path):
    config = open_scenes(6.5, 1.0, outputs=("visibility", "instances", "sky"))
    encoded = config.model_copy(update={"files": config.files.model_copy(update={"disparity": "png16"})})
    data, results = tmp_path / "data", tmp_path / "results"
    generate(encoded, data, 2, SEED, layout="webdataset")
    index = read_index(data)
    assert (index.plan.encodings.signed, index.plan.format) == (True, 1)
    assert verified(data, 50).findings == []
    results.mkdir()
    with PairRenderer(config, SEED) as renderer:
        for pair in open_dataset(data):
            made = renderer.render(pair.index).frame
            assert pair.left.disparity.min() < 0
            np.testing.assert_allclose(pair.left.disparity, made.left.disparity, atol=SIGNED_DISPARITY.error_px, rtol=0)
            np.testing.assert_array_equal(pair.sky_of_instances("left"), pair.left.sky == SKY)
            (results / f"{pair.name}.png").write_bytes(SIGNED_DISPARITY.encode(pair.left.disparity))
    for protocol in ("middlebury", "kitti", "eth3d", "paper"):
        mean = evaluate(results, data, protocol)["mean"]["all"]
        assert mean["avgerr"] < 0.003, protocol
        assert mean["coverage"] == PROTOCOLS[protocol].full_share, protocol


def test_a_run_that_ends_within_a_scene_goes_on_there_and_left_views_are_the_same_files(tmp_path):
    """With three baselines and four pairs per shard, shards end within a scene too."""
    config = several(sequence={"length": 2, "frame_s": 0.1}, outputs=["visibility", "depth", "flow"])
    whole, options = tmp_path / "whole", {"layout": "sceneflow", "shard_pairs": 4}
    generate(config, whole, 8, SEED, **options)
    with pytest.raises(KeyboardInterrupt):
        generate(config, tmp_path / "out", 8, SEED, **options, listener=Recorder(5))
    generate(config, tmp_path / "out", 8, SEED, layout="sceneflow")
    assert digests(tmp_path / "out") == digests(whole)
    plan, lefts = read_index(whole).plan, {}
    for pair in open_dataset(whole):
        scene, view = divmod(pair.index, 3)
        assert (pair.provenance["view"], pair.camera.baseline_m) == (view, SEVERAL[view])
        assert (pair.provenance["sequence"], pair.provenance["frame"]) == divmod(scene, 2)
        files = plan.files("train", pair.index)
        for role in ("left", "depth_left", "flow_left", "flow_visibility_left"):
            assert lefts.setdefault((scene, role), data := (whole / files[role]).read_bytes()) == data
    path = whole / plan.files("train", 2)["provenance"]
    change_json(path, lambda pair: pair.update(view=1))
    (found,) = findings(whole)
    assert (found.check, found.message) == ("origin", "view is 1, expected 2")
