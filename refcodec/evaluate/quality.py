"""Image quality: PSNR and SSIM, by scikit-image and as in the code of 3D Gaussian Splatting."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_] | None

# The window of SSIM: an 11 x 11 Gaussian of deviation 1.5; its constants for values from 0 to 1.
_SIGMA, _HALF = 1.5, 5
_WINDOW: dict[str, Any] = {"gaussian_weights": True, "sigma": _SIGMA, "use_sample_covariance": False}
_C1, _C2 = 0.01**2, 0.03**2


def counted(mask: Mask, *images: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Returns images [h, w, 3] with black where the mask, bool [h, w], is False. None leaves them as they are."""
    return images if mask is None else tuple(image * mask[..., None] for image in images)


def measures(made: NDArray[Any], photograph: NDArray[np.uint8], mask: Mask = None) -> dict[str, float]:
    """Returns PSNR in dB and SSIM of an image, float [h, w, 3] with 1 for white, against a photograph uint8 [h, w, 3].

    mask: whether each pixel counts, bool [h, w], None for all. Others are black in both images, and not in the means.
    psnr, ssim: by scikit-image, of the image rounded to eight bits; its SSIM omits a border of five pixels.
    psnr_3dgs, ssim_3dgs: of the unrounded image, clamped to 0 to 1, SSIM with zeros around both. Identical images have
    infinite PSNR.
    psnr_cc: as psnr_3dgs, after each channel of the image has the gain and the offset of least squared error to the
    photograph, clamped to 0 to 1: without the differences of exposure and white balance.
    """
    made, photograph = counted(mask, made, photograph)
    used = np.ones(photograph.shape[:2], bool) if mask is None else mask
    cut = np.clip(np.asarray(made, np.float64), 0, 1)
    right = photograph.astype(np.float64) / 255
    rounded = np.floor(cut * 255 + 0.5).astype(np.uint8)
    similar = structural_similarity(photograph, rounded, channel_axis=2, data_range=255, full=True, **_WINDOW)[1]
    inner = np.pad(used[_HALF:-_HALF, _HALF:-_HALF], _HALF)
    with np.errstate(divide="ignore"):
        return {
            "psnr": float(peak_signal_noise_ratio(photograph[used], rounded[used], data_range=255)),
            "ssim": float(similar[inner if inner.any() else used].mean()),
            "psnr_3dgs": float(-10 * np.log10(np.mean((cut[used] - right[used]) ** 2))),
            "ssim_3dgs": float(_ssim_3dgs(cut, right)[used].mean()),
            "psnr_cc": float(-10 * np.log10(np.mean((_best_colours(cut[used], right[used]) - right[used]) ** 2))),
        }


def _best_colours(made: F64, right: F64) -> F64:
    """Returns colours [n, 3] by the gain and the offset of each channel that bring them nearest to others [n, 3]."""
    made, middle = made - made.mean(axis=0), right.mean(axis=0)
    spread = (made**2).sum(axis=0)
    return np.clip(made * ((made * (right - middle)).sum(axis=0) / np.where(spread > 0, spread, 1)) + middle, 0, 1)


def _ssim_3dgs(a: F64, b: F64) -> F64:
    """Returns the similarity of each pixel and channel, with zeros outside the images."""
    x = np.arange(-_HALF, _HALF + 1)
    window = np.exp(-(x**2) / (2 * _SIGMA**2))
    window /= window.sum()

    def blurred(image: F64) -> F64:
        return correlate1d(correlate1d(image, window, axis=0, mode="constant"), window, axis=1, mode="constant")

    mean_a, mean_b = blurred(a), blurred(b)
    var_a, var_b, both = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2, blurred(a * b) - mean_a * mean_b
    return (2 * mean_a * mean_b + _C1) * (2 * both + _C2) / ((mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2))
