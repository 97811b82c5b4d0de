"""A draft's config as YAML with comments."""

import sys
import textwrap
from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import ScalarNode, SequenceNode
from ruamel.yaml.representer import RoundTripRepresenter

from semisynth_gl.calibration.draft import Draft, config_values
from semisynth_gl.config.load import overridden
from semisynth_gl.inputs.errors import abbreviate
from semisynth_gl.textures.image_files import printable

# Columns of comments; names of calibrations that a comment has.
_WIDTH, _SOURCES_SHOWN = 98, 5


class _Representer(RoundTripRepresenter):
    """Writes lists of numbers on one line, and text with unprintable letters in quotes.

    Without quotes, a line break of Unicode in a file's name would be read as a space.
    """

    def represent_list(self, values: list[Any]) -> SequenceNode:
        numbers = not any(isinstance(value, dict | str) for value in values)
        return self.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=numbers)

    def represent_str(self, text: str) -> ScalarNode:
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=None if text.isprintable() else '"')


_Representer.add_representer(list, _Representer.represent_list)
_Representer.add_representer(str, _Representer.represent_str)


def write(draft: Draft) -> str:
    """Return the draft's config as YAML with comments."""
    comments = {
        "name": f"{draft.name}: written by semisynth-gl calibrate.",
        "camera": f"From {abbreviate([*dict.fromkeys(rig.source for rig in draft.rigs)], _SOURCES_SHOWN)}.",
        "lens": "The cameras before rectification: images get their borders and softness.",
        "disparity": f"{draft.disparity.origin} max_px is a hard limit: it sets the near plane.",
        "background": "Back walls at the farthest 5 % of the pixels, or outdoors a far plane beyond min_px.",
        "scenes": draft.style.origin,
        "textures": f"Photographs: {draft.photographs} when this was written.",
    }
    yaml, text = YAML(), StringIO()
    yaml.Representer, yaml.width = _Representer, sys.maxsize
    yaml.indent(mapping=2, sequence=4, offset=2)
    for name, section in overridden(config_values(draft), draft.overrides).items():
        text.writelines(f"# {line}\n" for line in textwrap.wrap(printable(comments.get(name, "")), _WIDTH))
        yaml.dump({name: section}, text)
        text.write("\n")
    return text.getvalue().rstrip("\n") + "\n"
