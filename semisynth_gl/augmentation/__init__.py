"""Changes of pairs for training that keep the truth exact. It needs no PyTorch; `semisynth_gl.torch` applies them."""
