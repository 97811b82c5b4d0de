"""Plug-ins of the made-up company Acme."""

from acme_stereo.layouts import FLAT
from acme_stereo.models import knot
from acme_stereo.recipes import ATTIC
from acme_stereo.textures import posters

PLUGINS = {
    "layouts": {"flat": FLAT},
    "textures": {"posters": posters},
    "models": {"knots": knot},
    "recipes": {"attic": ATTIC},
}
