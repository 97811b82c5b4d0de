"""``semisynth-gl doctor``."""

import platform
from importlib.metadata import version
from pathlib import Path

import click

from semisynth_gl.cache import cache_folder
from semisynth_gl.cli.options import Command
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.inputs.opencv import open_opencv
from semisynth_gl.plugins import NOUNS, installed_plugins
from semisynth_gl.render import Backend

_PACKAGES = ("semisynth-gl", "moderngl", "glcontext", "numpy", "trimesh", "Pillow", "isal", "scikit-image")
_LARGEST_ERROR_PX = 1e-3
# This file exists if the kernel has a driver for an NVIDIA GPU.
_NVIDIA_CONTROL = Path("/dev/nvidiactl")


@click.command(cls=Command)
def doctor() -> None:
    """Check whether this machine can render.

    Lists packages, plug-ins, EGL's devices and the backends, and checks the disparity of a test pair with each backend.
    """
    # Imported here, as in `_try`: help and completion need no OpenGL.
    from semisynth_gl.render.devices import egl_devices  # noqa: PLC0415

    click.echo(f"Python {platform.python_version()} on {platform.platform()}")
    for package in _PACKAGES:
        click.echo(f"  {package} {version(package)}")
    click.echo(f"  OpenCV {_opencv_version()}")
    for group, plugins in installed_plugins().items():
        for name, plugin in plugins.items():
            release = f"{plugin.package['package']} {plugin.package['version']}"
            click.echo(f"Plug-in: {NOUNS[group]} {name!r} of the package {release}")
    click.echo(f"Cache: {cache_folder() or 'off'}")
    click.echo("EGL devices (in EGL's order, which is not CUDA's)")
    for device in egl_devices():
        cuda = "" if device.cuda is None else f"GPU {device.cuda} of CUDA's"
        click.echo(f"  {device.index}: {cuda or ('software' if device.software else 'another GPU')}")
    if not egl_devices():
        click.echo("  none")
    if _NVIDIA_CONTROL.exists() and all(device.cuda is None for device in egl_devices()):
        click.echo("  the NVIDIA GPU is not among them; see 'GPU' on the manual's page 'Install'")
    backends: tuple[Backend, ...] = ("egl", "osmesa")
    working = [backend for backend in backends if _try(backend)]
    if not working:
        click.echo("No backend renders exact disparities: nothing can be rendered here.")
        click.get_current_context().exit(1)
    click.echo(f"Ready: {', '.join(working)}")


def _try(backend: Backend) -> bool:
    """Print a backend's facts, and render a test pair; return whether its disparity is exact."""
    from semisynth_gl.bench.accuracy import plane_error_px  # noqa: PLC0415
    from semisynth_gl.render.context import context_facts  # noqa: PLC0415

    click.echo(f"Backend {backend}")
    try:
        facts = context_facts(backend)
        click.echo(f"  {facts['renderer']}")
        click.echo(f"  OpenGL {facts['opengl']}")
        error_px = plane_error_px(backend)
    except BackendError as error:
        click.echo("  " + str(error).replace("\n", "\n  "))
        return False
    good = error_px <= _LARGEST_ERROR_PX
    verdict = "good" if good else f"WRONG, at most {_LARGEST_ERROR_PX:g} was expected"
    click.echo(f"  test pair: largest error of the disparity {error_px:.1e} px: {verdict}")
    return good


def _opencv_version() -> str:
    # Several packages provide OpenCV, so ask the module.
    try:
        return str(open_opencv("the section lens").__version__)
    except InputError:
        return "not installed: needed by the config's section lens, and by calibrate for cameras that are not rectified"
