"""The paper's tables: their data against the paper's splits, and a dry run of every kind of cell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from chona_model.data.dataset import DatasetError, Person, Pose
from chona_model.formats.model_file import read_header
from chona_model.methods import METHODS
from chona_model.progress import Progress
from chona_model.reproduce.cell import Protocol
from chona_model.reproduce.exchange import performed_by, with_objects
from chona_model.reproduce.run import Reproduction, reproduce
from chona_model.reproduce.sources import open_cell
from chona_model.reproduce.tables import TableError, cells_of, find_table, read_tables
from chona_model.skeleton import SMPL, forward_kinematics

DRY = Protocol(minutes=None, steps=3, image_scale=0.125, quality="draft", frames=1)


def test_tables_hold_the_papers_splits_and_figures() -> None:
    tables = read_tables()
    assert list(tables) == ["novel-pose", "boxes", "compositional", "static-object", "novel-person"]
    pose = tables["novel-pose"]
    assert pose.columns["suitcase"].train == ("behave/Date01_Sub01_suitcase_lift",)
    assert pose.columns["chairwood"].tests == {"chairwood": ("behave/Date01_Sub01_chairwood_lift",)}
    means = {row: np.mean([psnr for psnr, _ in words.paper.values()]) for row, words in pose.rows.items()}
    assert means["chona"] - means["tava"] == pytest.approx(2.0, abs=0.05)  # as the paper's text says
    assert means["chona"] - means["arah"] == pytest.approx(1.9, abs=0.05)
    compositional = tables["compositional"].columns["all"]
    assert len(compositional.train) == 13 and [len(test) for test in compositional.tests.values()] == [7, 6, 11]
    for table in tables.values():
        for column in table.columns.values():
            if not column.divided and column.tests and table.title != "Novel static objects (chairwood)":
                tests = {source for sources in column.tests.values() for source in sources}
                assert not tests & set(column.train)
        assert set(table.rows) <= set(METHODS)
        for words in table.rows.values():
            assert set(words.paper) <= set(table.tests)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("novel",), "no table 'novel'; expected one of novel-pose, boxes"),
        (("boxes", ("magic",)), "the table boxes has no row 'magic'; it has tava, arah, chona"),
        (("boxes", None, ("crate",)), "the table boxes has no column 'crate'; it has boxlarge"),
    ],
)
def test_what_the_tables_have_not_is_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(TableError, match=message):
        cells_of(*arguments)


def test_splits_of_the_benchmark_are_the_papers(hoibench: Path) -> None:
    stated = json.loads((hoibench / "splits.json").read_text())
    for name, column in find_table("novel-pose").columns.items():
        assert [source.removeprefix("behave/") for source in column.train] == stated["novel_pose"][name]["train"]
        assert [source.removeprefix("behave/") for source in column.tests[name]] == stated["novel_pose"][name]["val"]


def test_divided_sequences_share_no_frame(hoibench: Path, tmp_path: Path) -> None:
    (cell,) = cells_of("boxes", ("chona",), ("boxsmall",))
    (tmp_path / "behave").symlink_to(hoibench / "behave")
    by_file, by_lot = open_cell(hoibench, cell, None), open_cell(tmp_path, cell, hoibench / "smplh")
    for data in (by_file, by_lot):
        train, test = ({view.frame for view in part.views} for part in (data.train, data.tests["boxsmall"]))
        assert train and test and not train & test
    assert {view.frame for view in by_file.tests["boxsmall"].views} == {"t0003.000"}
    assert len({view.frame for view in by_lot.train.views}) == 6  # 0.7 of the 8 frames there are


def test_a_table_is_made_cell_by_cell_and_continued(hoibench: Path, tmp_path: Path) -> None:
    task = Reproduction("novel-pose", hoibench, tmp_path, ("tava", "chona"), ("chairwood",))
    told = reproduce(task, DRY, Progress(), [])
    assert (told["cells"], told["kept"], told["of"]) == (2, 0, 2)
    folder = tmp_path / "novel-pose"
    table = json.loads((folder / "novel-pose.json").read_text())
    for row in ("tava", "chona"):
        made = table["rows"][row]["tests"]["chairwood"]
        report = json.loads((folder / "cells" / f"{row}-chairwood" / "chairwood.json").read_text())
        assert made["psnr"] == report["mean"]["psnr"] and made["paper_psnr"] in (26.0, 27.3)
        assert read_header(folder / "cells" / f"{row}-chairwood" / "run" / "model.safetensors").method == row
        with Image.open(folder / f"{row}.png") as image:
            assert image.width == 256
    words = (folder / "novel-pose.md").read_text()
    assert f"{table['rows']['chona']['tests']['chairwood']['psnr']:.2f} / " in words and "(27.3 / 0.969)" in words
    assert "| ARAH (`arah`) | – (27.9 / 0.969)" in words
    times = {path: path.stat().st_mtime_ns for path in folder.glob("cells/*/run/*")}
    again = reproduce(task, DRY, Progress(), [])
    assert (again["cells"], again["kept"]) == (0, 2)
    assert times == {path: path.stat().st_mtime_ns for path in folder.glob("cells/*/run/*")}
    other = Protocol(minutes=None, steps=4, image_scale=0.125, quality="draft", frames=1)
    with pytest.raises(TableError, match=r"made by another protocol .steps was 3, is 4.; give the same one"):
        reproduce(task, other, Progress(), [])


def test_missing_data_are_named(tmp_path: Path) -> None:
    (tmp_path / "behave" / "sequences").mkdir(parents=True)
    task = Reproduction("novel-pose", tmp_path, tmp_path / "out", ("chona",), ("yogaball",))
    with pytest.raises(DatasetError, match="no sequence 'Date01_Sub01_yogaball'"):
        reproduce(task, DRY, Progress(), [])


def test_a_performance_is_given_to_another_body() -> None:
    random = np.random.default_rng(7)
    joints, others = (random.normal(size=(24, 3)) for _ in range(2))
    turns = Rotation.random(24, random_state=1).as_matrix()
    place = np.array([1.0, 2.0, 3.0])
    pose = Pose("one", ("chair",), forward_kinematics(SMPL, joints, turns, place), np.eye(4)[None])
    given = performed_by(pose, SMPL, Person("other", others))
    expected = forward_kinematics(SMPL, others, turns, joints[0] + place - others[0])
    assert given.person == "other" and np.allclose(given.world_from_bone, expected)
    assert with_objects(pose, ("bowl",)).objects == ("bowl",)
    with pytest.raises(ValueError, match="1 objects, 2 names"):
        with_objects(pose, ("bowl", "cup"))
