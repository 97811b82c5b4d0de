#!/bin/sh
# Bring what pip cannot: Python's venv module, OpenGL's libraries and a driver.
#
#   tools/system-packages.sh PYTHON BACKEND...
#
# BACKEND is auto, egl or osmesa; of several, one that works is enough to go on. Does nothing where all is well.
# Otherwise it installs Debian's packages if it may (as root, or with a sudo that asks for no password), and if it may
# not, it stops with the one line to type.
set -eu

# The packages that semisynth_gl/render/context.py names too.
opengl_packages="libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri"
osmesa_package="libosmesa6"

python=$1
shift
backends=$*

say() {
    echo "$@" >&2
}

# The only proof of OpenGL is an open context, and it takes the installed package. Before that, the system's Python can
# at least load the libraries: whoever lacks them hears so before anything is downloaded. (-P: the checkout itself, which
# stands in the current folder without what it needs, is not the installed package.)
works() {
    "$python" -P - "$1" >/dev/null 2>&1 <<'END'
import sys
from ctypes import CDLL

backend = sys.argv[1]
try:
    from semisynth_gl.render.context import open_context
except ImportError:
    libraries = {"egl": ["libEGL.so.1", "libGL.so.1"], "osmesa": ["libOSMesa.so.8"]}
    try:
        for library in libraries.get(backend, libraries["egl"]):
            CDLL(library)
    except OSError:
        if backend != "auto":
            raise
        CDLL(*libraries["osmesa"])
else:
    open_context(backend).release()
END
}

# Sets $working and $missing.
try_backends() {
    working=""
    missing=""
    for backend in $backends; do
        if works "$backend"; then working="$working $backend"; else missing="$missing $backend"; fi
    done
}

# Sets $venv_package to what brings Python's venv module, or to nothing.
try_venv() {
    venv_package=""
    "$python" -c "import ensurepip, venv" 2>/dev/null ||
        venv_package="$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
}

apt_has() {
    apt-cache show "$1" >/dev/null 2>&1
}

if ! "$python" -c "import sys; sys.exit(sys.version_info < (3, 11))" 2>/dev/null; then
    found=$("$python" --version 2>/dev/null) || found="no such program"
    say "Python 3.11 or newer is needed, but $python is: $found. Name another: make PYTHON=python3.12 ..."
    exit 1
fi

try_venv
try_backends
if [ -z "$venv_package$missing" ]; then
    exit 0
fi
# A distribution whose Mesa has dropped OSMesa offers no package of it: nothing is left to install then.
if [ -z "$venv_package" ] && [ -n "$working" ] && [ "$missing" = " osmesa" ] && apt_has libegl1 &&
    ! apt_has "$osmesa_package"; then
    say "OSMesa is missing, and this system offers no package of it; going on with$working."
    exit 0
fi

# Tells what is missing, and stops unless the rest is enough to go on with.
# $1: what to do about it.
stop_or_go_on() {
    lacking="${venv_package:+Python's venv module}${venv_package:+${missing:+ and }}${missing:+OpenGL}"
    # What to render with is named where it matters which.
    [ -z "$missing" ] || [ "$missing" = " auto" ] || lacking="$lacking ($(echo $missing))"
    if [ -z "$venv_package" ] && [ -n "$working" ]; then
        say "Missing: $lacking. Going on with$working. To have all: $1"
        exit 0
    fi
    say "Missing: $lacking. $1"
    exit 1
}

if ! command -v apt-get >/dev/null; then
    stop_or_go_on "Install it with this system's package manager: libEGL.so.1, libGL.so.1 and a driver make OpenGL."
fi

packages="$venv_package"
[ -z "$missing" ] || packages="$packages $opengl_packages"
may=no
sudo=""
if [ "$(id -u)" -eq 0 ]; then
    may=yes
elif command -v sudo >/dev/null; then
    sudo="sudo "
    ! sudo -n true 2>/dev/null || may=yes
fi

if [ $may = yes ]; then
    # A package list that cannot be fetched may have nothing to do with these packages: installing them will tell.
    ${sudo}apt-get update -q || say "apt-get update failed; going on with the package lists that are here."
fi
if [ -n "$missing" ] && apt_has "$osmesa_package"; then
    packages="$packages $osmesa_package"
fi
packages=${packages# }

if [ $may = no ]; then
    who=""
    [ -n "$sudo" ] || who=", as root"
    stop_or_go_on "Type this$who: ${sudo}apt-get update && ${sudo}apt-get install -y $packages"
fi

say "Installing $packages"
${sudo}env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages
try_venv
try_backends
if [ -n "$venv_package" ]; then
    say "$venv_package is installed, and still $python has no venv module."
    exit 1
fi
if [ -z "$working" ]; then
    say "The packages are installed, and still no OpenGL context opens ($(echo $missing)). \`make doctor\` shows why."
    exit 1
fi
