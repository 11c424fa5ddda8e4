"""Pages of a register: instruments, control charts, due list and recall, of a register in the project."""

import datetime
from pathlib import Path

import bench
import numpy as np
import pytest

from lmeasure.register import Entry, Register, Result

HOSTILE = "R-1<script>alert(1)</script>"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    rng = np.random.default_rng(4)
    values = np.append(0.5 + 0.01 * rng.normal(size=14), 0.6)
    calibration = Entry("calibration", "c" * 64, "cal/calibration.json", "cell", datetime.date(2025, 1, 1))
    certificates = [
        Entry("certificate", f"{n:064x}", f"c/{n}", HOSTILE, datetime.date(2025, 1, 2) + datetime.timedelta(days=30 * n),
              {"AP_p P1": Result(float(v), 0.01, "mm")}, ("c" * 64,))
        for n, v in enumerate(values)
    ]  # fmt: skip
    register = Register(folder / "register")
    register.add([calibration, *certificates], "A")
    register.close()
    (folder / "register" / "limits.toml").write_text(
        f'schema = "lmeasure.limits/1"\n[[limit]]\nsubject = "{HOSTILE}"\nresult = "AP_p P1"\nupper = 0.55\n'
    )
    return folder


def test_a_register_has_a_page_for_each_question(project: Path) -> None:
    with bench.client(project) as session:
        first = session.get("/register")
        assert '<a href="/register"' in session.get("/").text
        assert first.status_code == 200
        assert "<script>alert" not in first.text
        assert first.text.count("/register/charts?") == 2
        charts = session.get(
            "/register/charts", params={"folder": "register", "subject": HOSTILE, "kind": "certificate", "result": "AP_p P1"}
        )
        assert charts.status_code == 200
        assert charts.text.count("<svg") == 4
        assert charts.text.count("<tr>") == 16
        # 0.6 after 14 values of 0.5 with a scatter of 0.01
        assert "Shewhart: signals" in " ".join(charts.text.split())
        assert "beyond its limits" in session.get("/register/due").text
        recall = session.get("/register/recall")
        assert "cal/calibration.json" in recall.text
        assert session.get("/register/recall", params={"folder": "register", "digest": "c" * 64}).text.count("c/") >= 15
        assert session.get("/register/charts", params={"subject": HOSTILE, "kind": "certificate"}).text.count("AP_p P1") == 1


def test_where_there_is_no_register_a_page_says_how_to_begin_one(project: Path, tmp_path: Path) -> None:
    with bench.client(tmp_path) as session:
        answer = session.get("/register")
        assert answer.status_code == 200
        assert "Add a first document" in answer.text
        assert "/run/register?register_dir=register" in answer.text
        assert session.get("/run/register?register_dir=register").status_code == 200
        assert session.get("/register/due").status_code != 200
        assert not (tmp_path / "register").exists()
    with bench.client(project) as session:
        assert session.get("/register", params={"folder": "../elsewhere"}).status_code in (403, 404, 422)
