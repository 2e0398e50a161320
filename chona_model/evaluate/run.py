"""Evaluation of a model on views that training did not see: metrics as in the paper, per view and on average."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from chona_model.data.dataset import Dataset, DatasetError
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import mean_of_known, score
from chona_model.formats.atomic import write_bytes
from chona_model.formats.model_file import file_hash, read_header
from chona_model.formats.picture import save_picture
from chona_model.methods import method_of
from chona_model.model_store import load_actor
from chona_model.presets import find_preset
from chona_model.progress import Progress

METRICS = ("psnr", "ssim", "psnr_box", "ssim_box", "seconds", "rays_per_second", "failed_share")


def evaluate(
    model: Path, dataset: Dataset, preset: str, image_scale: float, save_images: Path | None, json_path: Path,
    progress: Progress, device: str = "cpu",
) -> dict[str, Any]:  # fmt: skip
    """Renders every view of ``dataset`` and compares it with the picture, background removed and black.

    One untimed render goes first, so that compiling kernels is nobody's seconds.  When cancelled, the views done so far
    are written.

    Returns:
        what is written to ``json_path``.

    Raises:
        DatasetError: no views, or a view's person or object is unknown to the model.
        ModelFileError: the model cannot be loaded.
    """
    header = read_header(model)
    dataset = method_of(header.method).dataset(dataset)
    views = dataset.views
    if not views:
        raise DatasetError("there is not one view to evaluate; check the folder and --sequences with check-data")
    check_identities(dataset, header.persons, header.objects)
    actor = load_actor(model, device, list(dataset.persons), list(dataset.objects))
    settings = find_preset(preset)
    actor.render(views[0].pose, views[0].camera.scaled(image_scale), settings)
    images: list[dict[str, Any]] = []
    progress.start("evaluate", len(views), unit="view")
    for number, view in enumerate(views, start=1):
        if progress.cancelled_by_user:
            break
        pixels = load_pixels(view, image_scale)
        began = time.perf_counter()
        picture = actor.render(view.pose, view.camera.scaled(image_scale), settings)
        seconds = time.perf_counter() - began
        prediction = np.clip(picture.rgb, 0.0, 1.0)
        images.append(
            {
                "sequence": view.sequence,
                "frame": view.frame,
                "camera": view.camera_name,
                **asdict(score(prediction, pixels.rgb, pixels.mask)),
                "seconds": seconds,
                "rays_per_second": picture.rays * settings.supersampling**2 / seconds,
                "failed_share": picture.failed_share,
            }
        )
        if save_images is not None:
            save_picture(save_images / f"{view.label}_PREDICTION.png", prediction)
            save_picture(save_images / f"{view.label}_TARGET.png", pixels.rgb)
        progress.update(number, view.label, psnr=images[-1]["psnr"])
    mean = {name: mean_of_known([image[name] for image in images]) for name in METRICS}
    report: dict[str, Any] = {
        "mean": mean,
        "images": images,
        "settings": {**asdict(settings), "image_scale": image_scale},
        "model": {"path": str(model), "sha256": file_hash(model)},
        "machine": machine(),
    }
    write_bytes(json_path, json.dumps(report, indent=1).encode())
    finish = progress.cancelled if progress.cancelled_by_user else progress.result
    finish(json=str(json_path), views=len(images), **{name: mean[name] for name in ("psnr", "ssim")})
    return report


def check_identities(dataset: Dataset, persons: Collection[str], objects: Collection[str]) -> None:
    """``DatasetError`` where a dataset shows a person or an object that a model, which has these, does not know."""
    for kind, used, known in (("person", dataset.persons, persons), ("object", dataset.objects, objects)):
        unknown = sorted(set(used) - set(known))
        if unknown:
            raise DatasetError(
                f"the model has no {kind} '{unknown[0]}'; it knows {', '.join(known) or 'none'}: choose sequences with "
                "these, or train with that one"
            )


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "processor": platform.processor() or platform.machine(), "system": platform.system(),
        "cores": os.cpu_count(), "threads": torch.get_num_threads(), "torch": torch.__version__,
        "python": platform.python_version(),
    }  # fmt: skip
