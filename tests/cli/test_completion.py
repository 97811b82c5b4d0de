"""What the shell completes; test_rooms.py has that it need not wait for OpenGL."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import BashComplete

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import packaged_configs
from semisynth_gl.layouts import layout_names

NAME, VARIABLE = "semisynth-gl", "_SEMISYNTH_GL_COMPLETE"


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
    complete = BashComplete(semisynth_gl, {}, NAME, VARIABLE)
    assert [complete.format_completion(item) for item in complete.get_completions(before, begun)] == wanted


def test_bash_completes():
    script = f"""
eval "$({VARIABLE}=bash_source {NAME})"
COMP_WORDS=({NAME} generate --layout kit) COMP_CWORD=3
_semisynth_gl_completion {NAME}
echo "${{COMPREPLY[@]}}"
"""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["bash", "-e", "-c", script], capture_output=True, text=True, check=False, env=os.environ | {"PATH": path}
    )
    assert (done.stdout, done.stderr) == ("kitti\n", "")
