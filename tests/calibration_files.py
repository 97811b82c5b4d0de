"""Rectified and raw rigs, and calibration files that describe them."""

import numpy as np

from semisynth_gl.calibration.draft import describe
from semisynth_gl.calibration.rig import RectifiedRig
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.raw_camera import rotation_of

CAMERA = StereoCamera(741, 500, 994.978, 0.193001, 311.193, 342.279, 254.877)

MIDDLEBURY = """cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]
cam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]
doffs=31.086
baseline=193.001
width=741
height=500
ndisp=70
isint=0
vmin=7
vmax=61
"""
# The keys that we read of calib_cam_to_cam.txt in KITTI's raw recordings of 26 September 2011.
KITTI = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_02: 1.392000e+03 5.120000e+02
K_02: 9.597910e+02 0.000000e+00 6.960217e+02 0.000000e+00 9.569251e+02 2.241806e+02 0 0 1.000000e+00
S_rect_02: 1.242000e+03 3.750000e+02
P_rect_02: 7.215377e+02 0.000000e+00 6.095593e+02 4.485728e+01 0.000000e+00 7.215377e+02 1.728540e+02 2.163791e-01 \
0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
S_rect_03: 1.242000e+03 3.750000e+02
P_rect_03: 7.215377e+02 0.000000e+00 6.095593e+02 -3.395242e+02 0.000000e+00 7.215377e+02 1.728540e+02 2.199936e+00 \
0.000000e+00 0.000000e+00 1.000000e+00 2.729905e-03
"""
# A rig before rectification. FISHEYE: distortion coefficients of another lens.
SIZE = (640, 480)
K1 = np.array([[520.0, 0, 322], [0, 522, 236], [0, 0, 1]])
K2 = np.array([[525.0, 0, 315], [0, 524, 243], [0, 0, 1]])
D1 = np.array([-0.28, 0.09, 0.0005, -0.0003, 0.01])
D2 = np.array([-0.29, 0.1, -0.0004, 0.0002, 0.03])
FISHEYE = np.array([-0.03, 0.01, -0.005, 0.001])
R = np.array(rotation_of((0.01, -0.02, 0.006)))
T = np.array([-0.12, 0.001, 0.0005])
RAW = {"K1": K1, "D1": D1, "K2": K2, "D2": D2, "R": R, "T": T}
IMAGE = {"image_width": SIZE[0], "image_height": SIZE[1]}


def projections(alpha=-1.0):
    """Rectify the raw rig by OpenCV's stereoRectify."""
    import cv2

    turned = cv2.stereoRectify(K1, D1, K2, D2, SIZE, R, T[:, None], flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha)
    return dict(zip(("R1", "R2", "P1", "P2", "Q"), turned[:5], strict=True))


def write_storage(path, values):
    """Write values with cv2.FileStorage."""
    import cv2

    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        file.write(name, value if isinstance(value, str | int) else np.asarray(value))
    file.release()
    return path


def matrices(camera=CAMERA, unit_m=1.0):
    """Return the (3, 4) projection matrices of both eyes; the translation is in units of ``unit_m``."""
    left, right = (np.zeros((3, 4)) for _ in range(2))
    for p, cx in ((left, camera.cx_left_px), (right, camera.cx_right_px)):
        p[:, :3] = [[camera.focal_px, 0, cx], [0, camera.focal_y_px, camera.cy_px], [0, 0, 1]]
    right[0, 3] = -camera.focal_baseline / unit_m
    return left, right


def middlebury(camera=CAMERA):
    rows = ["; ".join(" ".join(map(repr, row)) for row in p[:, :3].tolist()) for p in matrices(camera)]
    return (
        f"cam0=[{rows[0]}]\ncam1=[{rows[1]}]\ndoffs={camera.doffs_px!r}\nbaseline={camera.baseline_m * 1000!r}\n"
        f"width={camera.width_px}\nheight={camera.height_px}\n"
    )


def kitti(camera=CAMERA, pair=("_rect_02", "_rect_03")):
    lines = []
    for number, p in zip(pair, matrices(camera), strict=True):
        lines.append(f"S{number}: {camera.width_px} {camera.height_px}")
        lines.append(f"P{number}: {' '.join(repr(float(value)) for value in p.ravel())}")
    return "\n".join(lines) + "\n"


def opencv(camera=CAMERA, *, unit_m=1.0, size=True):
    text = f"image_size: [{camera.width_px}, {camera.height_px}]\n" if size else ""
    return f"%YAML:1.0\n---\n{text}" + "".join(map(matrix, ("P1", "P2"), matrices(camera, unit_m)))


def matrix(name, value, *, space=" "):
    value = np.atleast_2d(value)
    data = ", ".join(map(repr, map(float, value.ravel())))
    rows, columns = value.shape
    return (
        f"{name}: !!opencv-matrix\n   rows:{space}{rows}\n   cols:{space}{columns}\n   dt: d\n   data:{space}[{data}]\n"
    )


def plain_rig(focal_px, baseline_m, width_px, height_px):
    return RectifiedRig(StereoCamera.centred(width_px, height_px, focal_px, baseline_m), "x")


def draft(rig, disparity):
    return describe("x", rig, ["a"], disparity, [ImageSize(256, 256)])
