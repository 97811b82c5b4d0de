#!/bin/sh
# Measure a machine with an NVIDIA GPU. It needs only Python, and takes ten minutes after the packages are installed:
#
#   benchmarks/gpu.sh [PART...]     doctor, tests, memory, speed, accuracy, training; by default all
#
# Each part writes PART.log into the folder OUT (out/gpu). PYTHON (python3) makes the environment VENV (.venv-gpu), which
# also uses PYTHON's packages, such as a PyTorch with CUDA. Without a package index, give a folder of wheels as WHEELS.
set -eu
cd "$(dirname "$0")/.."
outer=${PYTHON:-python3}
venv=${VENV:-.venv-gpu}
out=${OUT:-out/gpu}
python=$venv/bin/python

say() {
    echo "$@" >&2
}

install() {
    # Without python3-venv, the environment has no pip: PYTHON's pip installs into it.
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
    # If PYTHON is itself in an environment, --system-site-packages would give the system's packages instead of PYTHON's.
    "$outer" -c 'import sys; print("\n".join(path for path in sys.path if path.endswith("-packages")))' >"$own/outer.pth"
    if [ -z "${WHEELS:-}" ]; then
        install --editable ".[dev]"
    else
        # Packages that only some tests need may be missing in WHEELS.
        install hatchling editables
        install --no-build-isolation --editable . pytest pytest-xdist hypothesis
        for each in opencv-python-headless psutil webdataset fsspec imageio lightning tensorboard; do
            install "$each" || say "Going on without $each"
        done
    fi
    "$python" -c "import torch" 2>/dev/null || install torch==2.13.0 || say "Going on without PyTorch"
    # Bindings for a newer CUDA than PyTorch's may need a newer driver.
    cuda=$("$python" -c 'import torch; print((torch.version.cuda or "").split(".")[0])' 2>/dev/null) || cuda=""
    install "cuda-bindings${cuda:+==$cuda.*}" "cuda-bindings>=12.8" || say "Going on without cuda-bindings: no tensors on the GPU"
    touch "$venv/.ready"
fi
# Skipped if OpenGL works, since apt-get waits long on a machine without network.
if ! "$python" -c 'from semisynth_gl.render.context import open_context; open_context("egl")' 2>/dev/null; then
    sh tools/system-packages.sh "$python" egl || say "Going on without OpenGL's packages"
fi

mkdir -p "$out"
# Many containers lack the file by which EGL finds NVIDIA's driver.
if [ -e /dev/nvidiactl ] && ! grep -qs libEGL_nvidia /etc/glvnd/egl_vendor.d/*.json /usr/share/glvnd/egl_vendor.d/*.json
then
    echo '{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_nvidia.so.0"}}' >"$out/10_nvidia.json"
    export __EGL_VENDOR_LIBRARY_FILENAMES="$out/10_nvidia.json"
fi
export SEMISYNTH_GL_EXPECT_BACKENDS=egl
failed=0

# part NAME SECONDS ARGUMENTS: run Python with a time limit, and log its output.
part() {
    name=$1 seconds=$2
    shift 2
    if timeout "$seconds" "$python" "$@" >"$out/$name.log" 2>&1; then
        say "$name: done"
    else
        say "$name: failed or cut off; see $out/$name.log"
        failed=1
    fi
}

[ $# -gt 0 ] || set -- doctor tests memory speed accuracy training
for each; do
    case $each in
        doctor) part doctor 60 -m semisynth_gl doctor ;;
        tests) part tests 240 -m pytest -q -m opengl --numprocesses auto --dist worksteal ;;
        memory) part memory 120 benchmarks/memory_rates.py --config sceneflow --workers 1,2,4,8,16 ;;
        speed) part speed 120 -m semisynth_gl bench speed --pairs 64 --json "$out/speed.json" ;;
        accuracy) part accuracy 120 benchmarks/alternatives.py --json "$out/accuracy.json" ;;
        training) part training 240 examples/train.py --data zero-shot --crop 320 640 --batch 8 --out "$out/network" ;;
        *) say "$each: expected doctor, tests, memory, speed, accuracy or training"; exit 2 ;;
    esac
done
exit $failed
