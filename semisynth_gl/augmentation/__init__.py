"""Changes of training pairs that keep the truth exact, without PyTorch; `semisynth_gl.torch` applies them."""
