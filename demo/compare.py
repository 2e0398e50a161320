"""Demo stage 4: the composited frames beside Cycles' own render, with PSNR and SSIM, as a contact sheet and a film."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from chona_model.evaluate.metrics import psnr, ssim
from chona_model.formats.exr import read_frame

COLUMNS = 4
"""Pairs of frames in the contact sheet."""

FRAME_MILLISECONDS = 125


def compare(out: Path) -> dict[str, float]:
    """Writes ``contact_sheet.png`` and ``demo.gif``.

    Returns:
        mean ``psnr`` and ``ssim`` of whole frames, and ``psnr_figure`` over the pixels that the figure covers, dB.
    """
    made = sorted((out / "composite").glob("*.png"))
    true = [out / "reference" / path.name for path in made]
    pictures = [
        [np.asarray(Image.open(path).convert("RGB")) / 255.0 for path in pair] for pair in zip(made, true, strict=True)
    ]
    covered = [read_frame(path)[0].combined[..., 3] > 0.5 for path in sorted((out / "frames").glob("*.exr"))]
    errors = [np.mean((ours - theirs)[mask] ** 2) for (ours, theirs), mask in zip(pictures, covered, strict=True)]
    scores = {
        "psnr": float(np.mean([psnr(ours, theirs) for ours, theirs in pictures])),
        "ssim": float(np.mean([ssim(ours, theirs) for ours, theirs in pictures])),
        "psnr_figure": float(np.mean(-10.0 * np.log10(errors))),
    }
    _sheet(made, true, scores).save(out / "contact_sheet.png")
    frames = [Image.open(path).convert("RGB") for path in made]
    frames[0].save(
        out / "demo.gif", save_all=True, append_images=frames[1:] + frames[-2:0:-1], duration=FRAME_MILLISECONDS, loop=0
    )
    return scores


def _sheet(made: list[Path], true: list[Path], scores: dict[str, float]) -> Image.Image:
    chosen = [round(k) for k in np.linspace(0, len(made) - 1, min(COLUMNS, len(made)))]
    width, height = Image.open(made[0]).size
    title = 18
    sheet = Image.new("RGB", (len(chosen) * width, 2 * (height + title)), (24, 24, 26))
    draw = ImageDraw.Draw(sheet)
    words = (
        f"CHONA, composited by depth: {scores['psnr']:.1f} dB, SSIM {scores['ssim']:.3f} "
        f"(figure alone {scores['psnr_figure']:.1f} dB)",
        "Cycles, the original character in the same scene",
    )
    for row, (paths, line) in enumerate(zip((made, true), words, strict=True)):
        draw.text((6, row * (height + title) + 3), line, fill=(235, 235, 235))
        for column, index in enumerate(chosen):
            sheet.paste(Image.open(paths[index]).convert("RGB"), (column * width, row * (height + title) + title))
    return sheet


def write_report(out: Path, scores: dict[str, float], seconds: dict[str, float]) -> None:
    """``report.json``: scores and seconds of each stage."""
    (out / "report.json").write_text(json.dumps({"scores": scores, "seconds": seconds}, indent=1))
