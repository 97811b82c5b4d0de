"""What the shell completes; test_rooms.py has that it need not wait for OpenGL."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import BashComplete

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.config.keys import config_keys
from semisynth_gl.layouts import layout_names

NAME, VARIABLE = "semisynth-gl", "_SEMISYNTH_GL_COMPLETE"
KITTIS = [f"plain,{name}" for name in packaged_configs() if name.startswith("kit")]


def completed(*words):
    """What bash is told where the last word is begun: kinds and values."""
    complete = BashComplete(semisynth_gl, {}, NAME, VARIABLE)
    *before, begun = words
    return [complete.format_completion(item) for item in complete.get_completions(before, begun)]


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("gen",), ["plain,generate"]),
        (("bench", "acc"), ["plain,accuracy"]),
        (("generate", "--lay"), ["plain,--layout"]),
        (("generate", "--layout", "middlebury"), ["plain,middlebury", "plain,middlebury-2014"]),
        (("generate", "--layout", ""), [f"plain,{name}" for name in layout_names()]),
        (("generate", "--backend", "e"), ["plain,egl"]),
        (("generate", "--engine", "r"), ["plain,ray"]),
        (("generate", "--outputs", "dep"), ["plain,depth"]),
        (("generate", "--outputs", "depth,flow_"), ["plain,depth,flow_backward"]),
        (("generate", "--outputs", "depth,dep"), []),
        (("generate", "--set", "camera.width"), ["plain,camera.width_px="]),
        (("generate", "--set", "anti"), ["plain,antialias="]),
        (("preview", "--set", "no.such"), []),
        (("preview", "--set", "textures.pat"), ["plain,textures.patch_px="]),
        (("bench", "speed", "--set", "disparity.ma"), ["plain,disparity.max_px="]),
        # Files come first: bash forgets what stands before them.
        *(
            ((*command, "kit"), ["file,kit", *KITTIS])
            for command in (
                ("generate", "--config"),
                ("preview", "--config"),
                ("configs",),
                ("bench", "accuracy", "--config"),
            )
        ),
        (("generate", "--config", "lab/"), ["file,lab/"]),
        (("generate", "--images", "pho"), ["file,pho"]),
        (("generate", "--models", "mo"), ["file,mo"]),
        (("verify", "out/"), ["file,out/"]),
        (("report", "out/", "--split", "t"), ["plain,train", "plain,test"]),
        (("evaluate", "--gt", "ou"), ["file,ou"]),
        (("evaluate", "--protocol", "k"), ["plain,kitti"]),
    ],
)
def test_a_word_is_completed(words, wanted):
    assert completed(*words) == wanted


def test_the_keys_are_those_that_can_be_set():
    keys = [key.dotted for key in config_keys() if not (key.is_section or key.of_form)]
    assert len(set(keys)) == len(keys)
    assert {key.partition(".")[0] for key in keys} == set(Config.model_fields)
    config = load_config("kitti")
    values = {}
    for key in keys:
        value = config.model_dump(mode="json")
        for part in key.split("."):
            # Empty families and scenes, and a rig that does not deviate, are left out of a config's values.
            value = {} if value is None else value.get(part)
        if value not in (None, {}):
            values[key] = value
    assert len(values) > 50
    assert load_config("kitti", values).digest() == config.digest()


def test_bash_completes():
    script = f"""
eval "$({VARIABLE}=bash_source {NAME})"
COMP_WORDS=({NAME} generate --layout kit) COMP_CWORD=3
_semisynth_gl_completion {NAME}
echo "${{COMPREPLY[@]}}"
complete -p {NAME}
"""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["bash", "-e", "-c", script], capture_output=True, text=True, check=False, env=os.environ | {"PATH": path}
    )
    assert done.stderr == ""
    assert done.stdout == f"kitti\ncomplete -o nosort -F _semisynth_gl_completion {NAME}\n"
