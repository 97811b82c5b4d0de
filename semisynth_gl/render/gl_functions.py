"""OpenGL functions that moderngl does not bind, called through their addresses."""

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GL_LOWER_LEFT = 0x8CA1
_GL_ZERO_TO_ONE = 0x935F
_GL_DITHER = 0x0BD0
_GL_DEPTH_COMPONENT32F = 0x8CAC
_GL_COLOR, _GL_DEPTH = 0x1800, 0x1801
_GL_TEXTURE_WRAP_S, _GL_TEXTURE_WRAP_T = 0x2802, 0x2803
_GL_MIRRORED_REPEAT = 0x8370
_GL_TEXTURE_BASE_LEVEL, _GL_TEXTURE_MAX_LEVEL = 0x813C, 0x813D
_GL_R8, _GL_R32F, _GL_RGB8, _GL_RGBA8, _GL_RED, _GL_RGBA = 0x8229, 0x822E, 0x8051, 0x8058, 0x1903, 0x1908
_GL_UNSIGNED_BYTE, _GL_COLOR_ATTACHMENT0, _GL_UNPACK_ALIGNMENT = 0x1401, 0x8CE0, 0x0CF5

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_FLOATS, _UINTS = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint)


class GLFunctions:
    """OpenGL 4.5 functions of one context; ``load`` returns the address of the function with a given name."""

    def __init__(self, load: Callable[[str], int]) -> None:
        def function(name: str, *types: Any, result: Any = None) -> Callable[..., Any]:  # noqa: ANN401 - ctypes has no common type
            return ctypes.CFUNCTYPE(result, *types)(load(name))

        self._clip_control = function("glClipControl", _UINT, _UINT)
        self._disable = function("glDisable", _UINT)
        self._renderbuffer_storage = function("glNamedRenderbufferStorage", _UINT, _UINT, _INT, _INT)
        self._clear_float = function("glClearBufferfv", _UINT, _INT, _FLOATS)
        self._clear_unsigned = function("glClearBufferuiv", _UINT, _INT, _UINTS)
        self._texture_parameter = function("glTextureParameteri", _UINT, _UINT, _INT)
        self._texture_storage = function("glTextureStorage3D", _UINT, _INT, _UINT, _INT, _INT, _INT)
        self._texture_write = function("glTextureSubImage3D", _UINT, *[_INT] * 7, _UINT, _UINT, ctypes.c_void_p)
        self._pixel_store = function("glPixelStorei", _UINT, _INT)
        self._framebuffer_texture = function("glNamedFramebufferTexture", _UINT, _UINT, _UINT, _INT)
        self._reset_status = function("glGetGraphicsResetStatus", result=_UINT)

    def set_up(self) -> None:
        """Map clip z to [0, 1] instead of [-1, 1], and switch off dithering.

        With [-1, 1], the depth written is 0.5 z + 0.5, and the sum rounds away the precision of reversed Z near 0. By
        default, drivers may dither colours, which would change them.
        """
        self._clip_control(_GL_LOWER_LEFT, _GL_ZERO_TO_ONE)
        self._disable(_GL_DITHER)

    def clear_float(self, attachment: int, value: float) -> None:
        """Clear a float or fixed-point attachment of the framebuffer in use."""
        self._clear_float(_GL_COLOR, attachment, (ctypes.c_float * 4)(*[value] * 4))

    def clear_unsigned(self, attachment: int, value: int) -> None:
        """Clear an unsigned integer attachment of the framebuffer in use, for which clearing by floats is undefined."""
        self._clear_unsigned(_GL_COLOR, attachment, (ctypes.c_uint * 4)(*[value] * 4))

    def clear_depth(self, value: float) -> None:
        """Clear the depth buffer of the framebuffer in use."""
        self._clear_float(_GL_DEPTH, 0, ctypes.byref(ctypes.c_float(value)))

    def is_lost(self) -> bool:
        """Return whether the driver reports a lost context: the GPU was reset or taken away."""
        return bool(self._reset_status())

    def mirror_beyond_border(self, texture: int) -> None:
        """Make a texture mirrored beyond its border."""
        for wrap in (_GL_TEXTURE_WRAP_S, _GL_TEXTURE_WRAP_T):
            self._texture_parameter(texture, wrap, _GL_MIRRORED_REPEAT)

    def store_layers(self, texture: int, levels: int, layers: NDArray[np.uint8], *, software: bool) -> None:
        """Give an array texture storage of several levels, and upload layers, (L, P, P, 4) or (L, P, P) uint8.

        moderngl's storage has only one level. No shader reads alpha, and llvmpipe (``software``) filters three
        components faster than four, and 32-bit grey faster than 8-bit grey. Some other drivers cannot draw into levels
        without alpha.
        """
        count, side = layers.shape[:2]
        given, stored = (_GL_RGBA, _GL_RGB8 if software else _GL_RGBA8)
        if layers.ndim == 3:
            given, stored = (_GL_RED, _GL_R32F if software else _GL_R8)
        self._texture_storage(texture, levels, stored, side, side, count)
        everything = 0, 0, 0, 0, side, side, count  # level, x, y, layer, width, height, layers
        # Rows of grey bytes need no padding. moderngl sets this alignment again whenever it writes.
        self._pixel_store(_GL_UNPACK_ALIGNMENT, 1)
        self._texture_write(texture, *everything, given, _GL_UNSIGNED_BYTE, layers.ctypes.data)

    def limit_levels(self, texture: int, first: int, last: int) -> None:
        """Restrict shaders' look-ups in a texture to the levels from ``first`` to ``last``."""
        self._texture_parameter(texture, _GL_TEXTURE_BASE_LEVEL, first)
        self._texture_parameter(texture, _GL_TEXTURE_MAX_LEVEL, last)

    def attach_level(self, framebuffer: int, texture: int, level: int) -> None:
        """Make one level of a texture, with all its layers, the first colour attachment of a framebuffer."""
        self._framebuffer_texture(framebuffer, _GL_COLOR_ATTACHMENT0, texture, level)

    def make_depth_float32(self, renderbuffer: int, width_px: int, height_px: int) -> None:
        """Give a renderbuffer 32-bit float depth storage, which all drivers have; moderngl's is 24-bit integer."""
        self._renderbuffer_storage(renderbuffer, _GL_DEPTH_COMPONENT32F, width_px, height_px)
