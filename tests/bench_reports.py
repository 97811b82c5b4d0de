"""A config for the reports of bench that takes seconds, and the rows of such a report."""

from tiny_datasets import CLUTTER_ALONE

SMALL = (
    *CLUTTER_ALONE,
    "camera.width_px=160",
    "camera.height_px=100",
    "camera.cx_left_px=80.3",
    "camera.cx_right_px=80.3",
    "camera.cy_px=49.1",
    "particles.size_px=[8, 60]",
    "textures.source=procedural",
    "textures.max_patches=8",
    "models.variants=1",
    "models.complex=0",
)


def rows(report, part):
    return {row["name"]: row for row in report[part]["rows"]}
