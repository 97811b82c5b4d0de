"""On a real GPU: pairs that stay there have the same values as pairs read through main memory."""

import pytest
from heavy import heavy
from tiny_datasets import cheap

torch = heavy("torch")
if not torch.cuda.is_available():
    pytest.skip("needs a GPU that PyTorch sees", allow_module_level=True)
pytestmark = pytest.mark.heavy

from semisynth_gl.frame.channels import RENDERED_OUTPUTS  # noqa: E402
from semisynth_gl.torch import StereoStream  # noqa: E402


@pytest.mark.parametrize("crop", [None, (20, 30)])
def test_tensors_are_those_of_main_memory(crop):
    config = cheap(outputs=RENDERED_OUTPUTS, sequence={"length": 2})
    through_memory, on_gpu = (
        list(StereoStream(config, 3, 6, crop=crop, checked=False, device=device)) for device in ("cpu", "cuda")
    )
    assert len(on_gpu) == 6
    for expected, found in zip(through_memory, on_gpu, strict=True):
        assert expected.keys() == found.keys()
        for name, value in expected.items():
            if torch.is_tensor(value) and value.ndim > 1:
                assert found[name].is_cuda
                torch.testing.assert_close(found[name].cpu(), value, rtol=0, atol=0, equal_nan=True, msg=name)
