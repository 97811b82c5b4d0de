"""Networks of the package stereo-matching (MIT, tested: 0.2.0) for `train.py`.

    pip install stereo-matching timm
    python examples/train.py --network public_networks:stereo_matching --argument model=raft-stereo-realtime ...

The networks expect images normalised by ImageNet's mean and deviation (--levels imagenet). They return disparities of
the left view: one in evaluation, a list in training. The package has no weights. To train networks of other packages,
write a similar function that returns a torch.nn.Module.
"""

from typing import Any

from torch import nn

from semisynth_gl.inputs.errors import InputError


def stereo_matching(model: str, **settings: Any) -> nn.Module:  # noqa: ANN401 - settings have various types
    """Make a network with random weights.

    Args:
        model: raft-stereo, raft-stereo-realtime, igev-stereo, igev-plusplus, crestereo, aanet-sceneflow, unimatch or
            s2m2, as ``stereo_matching.registry`` lists them.
        settings: values of its config, such as num_iters.

    Raises:
        InputError: if there is no such network or setting.
    """
    import stereo_matching as _  # noqa: F401, PLC0415 - registers the networks
    from stereo_matching.registry import MODEL_REGISTRY  # noqa: PLC0415 - an optional package

    if model not in MODEL_REGISTRY.list_variants():
        raise InputError(f"model: expected one of {', '.join(MODEL_REGISTRY.list_variants())}, got {model!r}")
    config = MODEL_REGISTRY.get_config_cls(model).from_variant(model)
    for name, value in settings.items():
        if not hasattr(config, name):
            raise InputError(f"{name}: {model} has the settings {', '.join(vars(config))}")
        setattr(config, name, value)
    network: nn.Module = MODEL_REGISTRY.get_model_cls(model)(config)
    return network
