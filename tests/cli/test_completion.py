"""What the shell completes; test_rooms.py has that it need not wait for OpenGL."""

import pytest
from click.shell_completion import BashComplete

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import packaged_configs
from semisynth_gl.layouts import layout_names


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("gen", ["plain,generate"]),
        ("generate --layout ", [f"plain,{name}" for name in layout_names()]),
        ("generate --outputs depth,flow_", ["plain,depth,flow_backward"]),
        ("generate --set camera.width", ["plain,camera.width_px="]),
        # Files come first: bash forgets what stands before them.
        ("generate --config ", ["file,", *(f"plain,{name}" for name in packaged_configs())]),
    ],
)
def test_a_word_is_completed(words, wanted):
    *before, begun = words.split(" ")
    complete = BashComplete(semisynth_gl, {}, "semisynth-gl", "_SEMISYNTH_GL_COMPLETE")
    assert [complete.format_completion(item) for item in complete.get_completions(before, begun)] == wanted
