"""Structural similarity (SSIM) of two images, as 3D Gaussian Splatting defines it.

Wang et al., "Image quality assessment: from error visibility to structural similarity" (2004), with an 11 x 11 Gaussian
window of deviation 1.5, C1 = 0.01^2 and C2 = 0.03^2 for values in [0, 1], channel by channel, mean over all pixels. As
in 3DGS the images are padded with zeros, and the pixels near the edge count. scikit-image leaves out the outer five,
and therefore has another value.
"""

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d

RADIUS, DEVIATION = 5, 1.5
TAPS = 2 * RADIUS + 1
C1, C2 = 0.01**2, 0.03**2


_WEIGHTS = np.exp(-((np.arange(TAPS) - RADIUS) ** 2) / (2 * DEVIATION**2))
WINDOW = (_WEIGHTS / _WEIGHTS.sum()).astype(np.float32)


def ssim_torch(x: Tensor, y: Tensor) -> Tensor:
    """Mean SSIM of two images, float32 [H, W, C] with values in [0, 1]: a scalar, differentiated by autograd."""
    assert x.ndim == 3
    assert x.shape == y.shape
    height, width, channels = x.shape
    planes = torch.stack([x, y, x * x, y * y, x * y]).permute(0, 3, 1, 2).reshape(1, -1, height, width)
    groups = 5 * channels
    # With one group for each plane, torch uses its own kernel on a GPU. cuDNN's would round float32 to TF32.
    window = torch.from_numpy(WINDOW).to(x).expand(groups, 1, TAPS).contiguous()
    down = conv2d(planes, window[:, :, :, None], padding=(RADIUS, 0), groups=groups)
    means = conv2d(down, window[:, :, None, :], padding=(0, RADIUS), groups=groups)
    m_x, m_y, m_xx, m_yy, m_xy = means.reshape(5, channels, height, width)
    c1, c2 = float(np.float32(C1)), float(np.float32(C2))
    luminance = (2 * m_x * m_y + c1) / (m_x * m_x + m_y * m_y + c1)
    contrast_structure = (2 * (m_xy - m_x * m_y) + c2) / ((m_xx - m_x * m_x) + (m_yy - m_y * m_y) + c2)
    return (luminance * contrast_structure).mean()
