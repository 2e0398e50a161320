"""The paper's tables: their data against the paper's splits, and a dry run of every kind of cell."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tiny_behave import write_behave

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

NOVEL_POSE = """
    backpack | Date01_Sub01_backpack_hug Date01_Sub01_backpack_back | Date01_Sub01_backpack_hand
    chairwood | Date01_Sub01_chairwood_hand Date01_Sub01_chairwood_sit | Date01_Sub01_chairwood_lift
    chairblack | Date01_Sub01_chairblack_lift Date01_Sub01_chairblack_hand | Date01_Sub01_chairblack_sit
    suitcase | Date01_Sub01_suitcase_lift | Date01_Sub01_suitcase
    tablesmall | Date01_Sub01_tablesmall_lift Date01_Sub01_tablesmall_move | Date01_Sub01_tablesmall_lean
    tablesquare | Date01_Sub01_tablesquare_hand Date01_Sub01_tablesquare_lift | Date01_Sub01_tablesquare_sit
    yogaball | Date01_Sub01_yogaball | Date01_Sub01_yogaball_play
"""
"""Table 6 of the paper's appendix: object, training, validation."""

COMPOSITIONAL = {
    "train": """
        Sub01_chairwood_hand Sub01_chairwood_lift Sub01_tablesmall_lean Sub01_tablesmall_lift
        Sub01_yogaball_play Sub02_boxmedium_hand Sub02_boxsmall_hand Sub02_chairblack_hand
        Sub02_chairblack_lift Sub02_suitcase_ground Sub02_tablesquare_sit Sub02_tablesquare_lift
        Sub01_boxlarge_hand
    """,
    "novel action": """
        Sub01_yogaball Sub02_suitcase_lift Sub01_chairwood_sit Sub02_chairblack_sit Sub01_tablesmall_move
        Sub02_tablesquare_move Sub01_suitcase
    """,
    "novel object": """
        Sub01_chairblack_sit Sub02_chairwood_sit Sub01_suitcase_lift Sub02_yogaball_sit
        Sub02_tablesmall_move Sub01_tablesquare_hand
    """,
    "novel action-object": """
        Sub01_chairblack_hand Sub01_chairblack_lift Sub02_chairwood_hand Sub02_yogaball_play
        Sub02_tablesmall_lean Sub02_tablesmall_lift Sub01_tablesquare_sit Sub01_tablesquare_lift
        Sub02_boxlarge_hand Sub01_boxmedium_hand Sub01_boxsmall_hand
    """,
}
"""Table 7 of the appendix, which names no dates."""

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


def test_splits_are_the_appendix_s_name_by_name() -> None:
    columns = find_table("novel-pose").columns
    assert len(NOVEL_POSE.split("\n")) - 2 == len(columns)
    for line in NOVEL_POSE.strip().split("\n"):
        name, train, validation = (part.split() for part in line.split("|"))
        column = columns[name[0]]
        assert [source.removeprefix("behave/") for source in column.train] == train
        assert [[source.removeprefix("behave/") for source in test] for test in column.tests.values()] == [validation]
    column = find_table("compositional").columns["all"]
    named = {"train": column.train, **column.tests}
    assert list(named) == list(COMPOSITIONAL)
    for part, words in COMPOSITIONAL.items():
        # The first person was captured on the first date, the second on the second.
        assert [f"behave/Date{name[3:5]}_{name}" for name in words.split()] == list(named[part])
    trained = find_table("novel-person").columns["386-and-bowl"].train
    assert trained == (*column.train, "zju_mocap/CoreView_386", "co3d/bowl")
    assert find_table("boxes").columns.keys() == {"boxlarge", "boxmedium", "boxsmall", "boxtiny"}


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


def test_a_dry_run_of_a_whole_table_on_two_devices(tmp_path: Path) -> None:
    """As a user runs it, on two frames of every identity; the command's promise is two minutes."""
    column = find_table("static-object").columns["chairwood"]
    sources = {source for part in (column.train, *column.tests.values()) for source in part}
    write_behave(tmp_path / "data", sorted({source.split("/")[1] for source in sources}))
    words = ["reproduce", "static-object", "--data", tmp_path / "data", "--out", tmp_path / "out", "--dry-run"]
    command = [sys.executable, "-m", "chona_model", *map(str, words), "--devices", "cpu,cpu", "--progress", "json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    logs = [file.read_text() for file in (tmp_path / "out").glob("*/cells/*.log")]
    assert done.returncode == 0, [done.stderr, *logs]
    folder = tmp_path / "out" / "static-object"
    table = json.loads((folder / "static-object.json").read_text())
    assert list(table["rows"]) == ["joint-no-cil", "joint", "no-cil", "chona"]
    assert all(test["psnr"] > 0 for row in table["rows"].values() for test in row["tests"].values())
    with Image.open(folder / "static-object.png") as picture:
        assert picture.size == (2 * 256, 18 + 5 * (256 + 18))
    assert json.loads(done.stdout.splitlines()[-1])["cells"] == 4


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
