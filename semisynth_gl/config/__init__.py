"""Typed configurations, read from YAML."""

from semisynth_gl.config.fields import Range
from semisynth_gl.config.load import load_config, packaged_configs
from semisynth_gl.config.model import Config

__all__ = ["Config", "Range", "load_config", "packaged_configs"]
