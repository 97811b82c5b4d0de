#!/bin/sh
# Measure a machine with an NVIDIA GPU and nothing but Python, in ten minutes:
#
#   benchmarks/gpu.sh [--out DIR] [PART...]      see benchmarks/gpu.py --help
#
# PYTHON is python3 and VENV .venv-gpu unless they are set. The environment sees the packages that PYTHON has, so a
# PyTorch with CUDA that is there is used; otherwise it is downloaded, before the ten minutes begin. WHEELS is a folder of
# wheels, for a machine that reaches no package index.
set -eu
cd "$(dirname "$0")/.."
outer=${PYTHON:-python3}
venv=${VENV:-.venv-gpu}
python=$venv/bin/python

say() {
    echo "$@" >&2
}

install() {
    # PYTHON's pip can fill an environment that has none of its own, as on Debian without python3-venv.
    set -- install --quiet --disable-pip-version-check "$@"
    [ -z "${WHEELS:-}" ] || set -- "$@" --no-index --find-links "$WHEELS"
    if "$python" -m pip --version >/dev/null 2>&1; then
        "$python" -m pip "$@"
    else
        "$outer" -m pip --python "$python" "$@"
    fi
}

if [ ! -e "$venv/.ready" ]; then
    say "Making the environment $venv"
    "$outer" -m venv --clear "$venv" 2>/dev/null || "$outer" -m venv --clear --without-pip "$venv"
    own=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    # An environment made from another environment's Python would see the system's packages, and not that one's.
    "$outer" -c 'import sys; print("\n".join(path for path in sys.path if path.endswith("-packages")))' >"$own/outer.pth"
    if [ -z "${WHEELS:-}" ]; then
        install --editable ".[dev]"
    else
        # What only some tests need may be missing there.
        install hatchling editables
        install --no-build-isolation --editable . pytest pytest-xdist hypothesis
        for each in opencv-python-headless psutil webdataset fsspec imageio; do
            install "$each" || say "Going on without $each"
        done
    fi
    "$python" -c "import torch" 2>/dev/null || install torch==2.13.0 || say "Going on without PyTorch"
    # Bindings of a newer CUDA than PyTorch's may want a newer driver.
    cuda=$("$python" -c 'import torch; print((torch.version.cuda or "").split(".")[0])' 2>/dev/null) || cuda=""
    install "cuda-bindings${cuda:+==$cuda.*}" "cuda-bindings>=12.8" || say "Going on without cuda-bindings: no tensors on the GPU"
    touch "$venv/.ready"
fi
# What is there already may be all that there is to have: a machine that reaches no packages waits for them.
if ! "$python" -c 'from semisynth_gl.render.context import open_context; open_context("egl")' 2>/dev/null; then
    sh tools/system-packages.sh "$python" egl || say "Going on without OpenGL's packages"
fi
exec "$python" benchmarks/gpu.py "$@"
