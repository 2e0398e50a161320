"""Draws performances of a capture by persons and with objects that ``chona add`` gave to a model.

python scripts/draw_added.py MODEL DATA OUT.png SEQUENCE:VIEW[:PERSON[:OBJECT]] …

DATA is in BEHAVE's layout; VIEW counts the sequence's views from 0.  Without PERSON and OBJECT the capture's own act.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from chona_model.data.opener import open_dataset
from chona_model.formats.atomic import atomic_path
from chona_model.formats.picture import eight_bit
from chona_model.model_store import load_actor
from chona_model.reproduce.exchange import performed_by, with_objects
from chona_model.settings import RENDER_PRESETS

SIDE, MARGIN = 330, 8


def main(model: Path, data: Path, out: Path, shots: list[str]) -> None:
    """One square a shot, cut to the figure."""
    actor = load_actor(model)
    sheet = Image.new("RGB", (SIDE * len(shots), SIDE))
    for place, shot in enumerate(shots):
        sequence, number, person, thing = (shot.split(":") + ["", ""])[:4]
        view = open_dataset(data, "behave", sequences=[sequence]).views[int(number)]
        pose = view.pose
        if person:
            pose = performed_by(pose, actor.skeleton, actor.persons[person])
        if thing:
            pose = with_objects(pose, (thing,))
        picture = actor.render(pose, view.camera, RENDER_PRESETS["final"])
        rows, columns = np.nonzero(picture.alpha > 0.05)
        box = (columns.min() - MARGIN, rows.min() - MARGIN, columns.max() + MARGIN, rows.max() + MARGIN)
        image = Image.fromarray(eight_bit(picture.rgb)).crop(tuple(map(int, box)))
        scale = SIDE / max(image.size)
        image = image.resize((round(image.width * scale), round(image.height * scale)), Image.Resampling.LANCZOS)
        sheet.paste(image, (place * SIDE + (SIDE - image.width) // 2, (SIDE - image.height) // 2))
    with atomic_path(out) as temporary:
        sheet.save(temporary, format="PNG", optimize=True)


if __name__ == "__main__":
    if len(sys.argv) < 5:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
