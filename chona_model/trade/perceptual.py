"""LPIPS where the package and its weights are on this computer; nothing is ever fetched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from chona_model.trade.measure import Perceptual

WEIGHTS = "alexnet-owt-7be5be79.pth"
"""torchvision's file name for the network that LPIPS compares with."""


def find_lpips() -> Perceptual | None:
    """LPIPS (AlexNet) of two images [H, W, 3] in 0…1, or None where it is not installed."""
    if not (Path(torch.hub.get_dir()) / "checkpoints" / WEIGHTS).is_file():
        return None  # the package would fetch them
    try:
        import lpips
    except ImportError:
        return None
    network = lpips.LPIPS(net="alex", verbose=False).eval()

    def distance(one: np.ndarray, other: np.ndarray) -> float:
        images = [torch.from_numpy(np.moveaxis(image, -1, 0)[None].astype(np.float32)) for image in (one, other)]
        with torch.inference_mode():
            return float(network(*images, normalize=True))

    return distance
