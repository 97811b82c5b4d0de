#!/bin/sh
# Install the Debian packages that pip cannot install, if they are missing.
#
#   tools/system-packages.sh PYTHON [auto] [egl] [osmesa] [chromium]
#
# It checks Python's venv module, the named OpenGL backends, and Chromium, in which tests open the report. It needs root
# or a sudo without password; otherwise it prints the command. It fails if Python is too old, if venv is missing, or if
# none of the named backends works. Chromium may be missing: its tests are then skipped.
set -eu
python=$1
shift

say() {
    echo "$@" >&2
}

# An open context proves that OpenGL works. Before the program is installed, only its libraries can be loaded.
# -P ignores the checkout in the current folder, whose dependencies may be missing.
opens_context() {
    "$python" -P - "$1" >/dev/null 2>&1 <<'END'
import sys
from ctypes import CDLL

backend = sys.argv[1]
try:
    from semisynth_gl.render.context import open_context
except ImportError:
    try:
        for library in ["libOSMesa.so.8"] if backend == "osmesa" else ["libEGL.so.1", "libGL.so.1"]:
            CDLL(library)
    except OSError:
        if backend != "auto":
            raise
        CDLL("libOSMesa.so.8")
else:
    open_context(backend).release()
END
}

# Set $missing, $packages, $venv (missing or not) and $backend: none needed, missing, or one that works.
check() {
    missing="" packages="" venv="" backend=none
    if ! "$python" -c "import ensurepip, venv" 2>/dev/null; then
        venv=missing missing=" venv"
        packages=$("$python" -c 'import sys; print(" python%d.%d-venv" % sys.version_info[:2])')
    fi
    for need; do
        case $need in
            chromium)
                command -v chromium >/dev/null && command -v chromedriver >/dev/null && continue
                packages="$packages chromium chromium-driver" ;;
            *)
                if opens_context "$need"; then
                    backend=$need
                    continue
                fi
                [ $backend != none ] || backend=missing
                [ "$need" = osmesa ] || packages="$packages libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri"
                [ "$need" = egl ] || packages="$packages libosmesa6 libgl1" ;;
        esac
        missing="$missing $need"
    done
}

# Set $packages to those that this system offers. Mesa 25.1 dropped OSMesa, and Ubuntu's Chromium is a snap.
keep_offered() {
    apt-cache show libegl1 >/dev/null 2>&1 || return 0 # no package lists yet
    offered=""
    for package in $packages; do
        apt-cache show "$package" >/dev/null 2>&1 && offered="$offered $package"
    done
    packages=$offered
}

"$python" -c "import sys; sys.exit(sys.version_info < (3, 11))" 2>/dev/null || {
    say "Python 3.11 or newer is needed, but $python is $("$python" --version 2>/dev/null || echo missing): make PYTHON=python3.12 ..."
    exit 1
}
check "$@"
[ -n "$missing" ] || exit 0
sudo=""
[ "$(id -u)" -eq 0 ] || sudo="sudo -n"
command="apt-get install -y --no-install-recommends"
if ! command -v apt-get >/dev/null; then
    say "Missing:$missing. Install it with this system's package manager (OpenGL: libEGL, libGL and a driver)."
else
    keep_offered
    if [ -n "$packages" ] && [ -n "$sudo" ] && ! $sudo true 2>/dev/null; then
        say "As root, type: apt-get update && $command$packages"
    elif [ -n "$packages" ]; then
        say "Missing:$missing. Installing packages"
        $sudo apt-get update -q || say "apt-get update failed: using the package lists that are there."
        keep_offered
        $sudo env DEBIAN_FRONTEND=noninteractive $command -q $packages || say "apt-get install failed."
        check "$@"
    fi
    [ -z "$missing" ] || say "Missing:$missing."
fi
if [ -n "$venv" ] || [ $backend = missing ]; then
    say "Cannot go on. If OpenGL is missing, \`make doctor\` shows why."
    exit 1
fi
