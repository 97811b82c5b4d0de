"""The measurements of ``semisynth-gl bench``; making datasets does not need them."""
