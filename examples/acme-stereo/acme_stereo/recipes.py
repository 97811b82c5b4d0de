"""Acme's recipe of scenes."""

ATTIC = {
    "background": {"wall_turn_deg": 40},
    "structures": {"panels": [1, 4], "panel_slant_deg": [30, 75], "panel_curved": 0},
    "models": {"kinds": {"chair": 3, "bookcase": 2}},
    "textures": {"texels_per_pixel": [0.5, 2]},
}
