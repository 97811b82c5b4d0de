#!/bin/sh
# Build sdist and wheel into dist/, check them as a package index does, install the wheel into a fresh environment, and
# run it in an empty folder.
#
#   tools/release-check.sh PYTHON
set -eu
cd "$(dirname "$0")/.."
python=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export PIP_DISABLE_PIP_VERSION_CHECK=1 SEMISYNTH_GL_CACHE=off

rm -f dist/semisynth_gl-*
"$python" -m venv "$work/build"
"$work/build/bin/pip" install --quiet build twine
"$work/build/bin/python" -m build --outdir dist .
"$work/build/bin/twine" check --strict dist/semisynth_gl-*

"$python" -m venv "$work/user"
"$work/user/bin/pip" install --quiet dist/semisynth_gl-*.whl
mkdir "$work/empty"
cd "$work/empty"
program="$work/user/bin/semisynth-gl"
small="--set camera.width_px=320 --set camera.height_px=240"
"$program" --version
"$program" generate --config middlebury $small --pairs 2 --out pairs
"$program" verify pairs
"$program" report pairs --out pairs.html
"$program" preview --config middlebury $small --pairs 1 --out sheet.png
"$work/user/bin/python" -c "from semisynth_gl import open_dataset; print(open_dataset('pairs')[1].left.disparity.shape)"
echo "The package can be released:"
ls -l "$OLDPWD"/dist/semisynth_gl-*
