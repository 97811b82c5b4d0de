"""The measurements of ``semisynth-gl bench`` on the machine that it runs on; no dataset is made with this room."""
