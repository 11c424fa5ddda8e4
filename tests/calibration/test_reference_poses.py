"""Reference poses in the tables of others: any separator, unit, decimal mark and column name; slips are named."""

import csv
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from lmeasure.calibration import read_campaign, without_slips
from lmeasure.core import CalibrationError, LMeasureError
from lmeasure.io import columns_of

CELL = Path(__file__).parents[1] / "authorities" / "truth" / "cell-12-poses"


def rows() -> list[list[str]]:
    with (CELL / "reference_poses.csv").open(encoding="utf-8") as file:
        return list(csv.reader(file))


def folder(path: Path, table: bytes) -> Path:
    shutil.copytree(CELL, path)
    (path / "reference_poses.csv").write_bytes(table)
    return path


def test_a_table_of_another_program_is_the_same_campaign(tmp_path: Path) -> None:
    lines = ["Station 7 – Messung vom 3. Mai", "// exportiert", "Größe Punkt;X;Y;Z;O;A;T", ";m;m;m;rad;rad;rad"]
    for name, *cells in rows()[1:]:
        v = [float(c) for c in cells]
        given = [f"{x / 1e3:.12f}" for x in v[:3]] + [f"{math.radians(x):.15f}" for x in v[3:]]
        lines.append(";".join([name, *(c.replace(".", ",") for c in given)]))
    other = folder(tmp_path / "other", "\r\n".join(lines).encode("cp1252"))
    got, ours = read_campaign(other, columns_of("pose=Größe Punkt")), read_campaign(CELL)
    assert got.poses.names == ours.poses.names
    assert got.poses.rows == pytest.approx(ours.poses.rows, abs=1e-8)
    assert got.counts == pytest.approx(ours.counts)
    assert "position" in got.poses.absent
    with pytest.raises(LMeasureError, match=r"column 'pose' is missing. It has Größe Punkt, X, .*Assign the columns with --columns"):
        read_campaign(other, columns_of(""))


def test_uncertainties_and_inches_by_names_with_units(tmp_path: Path) -> None:
    head = "name\tx_in\ty_in\tz_in\to_deg\ta_deg\tt_deg\tu_position_um"
    lines = [head]
    for name, *cells in rows()[1:]:
        lines.append("\t".join([name, *(f"{float(c) / 25.4:.12f}" for c in cells[:3]), *cells[3:], "50"]))
    got = read_campaign(folder(tmp_path / "in", "\n".join(lines).encode("utf-16")))
    assert got.poses.rows[:, :3] == pytest.approx(read_campaign(CELL).poses.rows[:, :3], abs=1e-8)
    assert got.poses.u_position_mm == pytest.approx(np.full(12, 0.05))


@pytest.mark.parametrize(("size", "unit"), [(1e3, "metres"), (25.4, "inches")])
def test_positions_in_another_unit_are_refused_by_name(size: float, unit: str, tmp_path: Path) -> None:
    head, *given = rows()
    lines = [head, *([name, *(repr(float(c) / size) for c in cells[:3]), *cells[3:]] for name, *cells in given)]
    campaign = read_campaign(folder(tmp_path / unit, "\n".join(",".join(line) for line in lines).encode()))
    with pytest.raises(CalibrationError, match=rf"^poses\.csv: its positions are in {unit}, not millimetres"):
        without_slips(campaign, "poses.csv")
    assert without_slips(read_campaign(CELL), "poses.csv").notes == read_campaign(CELL).notes


def test_a_copied_row_is_used_once(tmp_path: Path) -> None:
    head, *given = rows()
    path = folder(tmp_path / "copy", "\n".join(",".join(line) for line in [head, *given, ["again", *given[3][1:]]]).encode())
    counts = (CELL / "counts.csv").read_text(encoding="utf-8").splitlines()
    again = ",".join(["again", *counts[4].split(",")[1:]])
    (path / "counts.csv").write_text("\n".join([*counts, again]) + "\n", encoding="utf-8")
    got = without_slips(read_campaign(path), "poses.csv")
    assert "pose again: a copy of pose 4 with the same counts, so it is used once" in got.notes
    assert got.used.sum() == read_campaign(CELL).used.sum()
