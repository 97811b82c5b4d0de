"""Typed configurations, read from YAML."""

from semisynth_gl.config.load import load_config, packaged_configs
from semisynth_gl.config.model import Config
from semisynth_gl.config.range import Range

__all__ = ["Config", "Range", "load_config", "packaged_configs"]
