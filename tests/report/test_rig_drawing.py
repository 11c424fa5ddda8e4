"""`lmeasure init --show`: each guide is drawn in the direction of its angles, and the page has the text of the file."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from lmeasure.report.rig_drawing import guide_drawing
from lmeasure.rig import read_rig
from lmeasure.workflows import init

STROKE = re.compile(r'd="M(\S+) (\S+)L(\S+) (\S+)" fill="none" stroke="#b3261e"')


def test_a_page_beside_the_file(tmp_path: Path) -> None:
    done = init.run_init(init.InitSettings(out=tmp_path / "cell", template="six-cables", show=True))
    page = (tmp_path / "cell" / "rig.html").read_text(encoding="utf-8")
    assert done.page == tmp_path / "cell" / "rig.html"
    assert page.count("guide_beta_deg 90") == 1
    assert "[[observation_point]]" in page


@pytest.mark.parametrize(("alpha", "beta", "offset"), [(47.0, 183.0, 25.0), (-20.0, -75.0, -60.0), (90.0, 0.0, 0.0)])
def test_directions_are_those_of_the_file(alpha: float, beta: float, offset: float) -> None:
    """Alpha from the horizontal downwards, beta from +Y towards +X, and the drum's path in proportion; y grows downwards on a page."""
    (point, *_) = read_rig(Path(__file__).parents[1] / "authorities" / "truth" / "cell-run" / "rig.toml").observation_point
    drum = point.drum.model_copy(update={"axial_offset_mm": offset})
    point = point.model_copy(update={"guide_alpha_deg": alpha, "guide_beta_deg": beta, "drum": drum})
    side, above, path = (np.array(ends, dtype=float) for ends in STROKE.findall(guide_drawing(point)))
    x, y = side[2:] - side[:2]
    assert math.degrees(math.atan2(y, -x)) == pytest.approx(alpha, abs=0.1)
    x, y = above[2:] - above[:2]
    assert (math.degrees(math.atan2(x, -y)) - beta + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.1)
    x, y = path[2:] - path[:2]
    assert y / x == pytest.approx(offset / drum.tangent_length_mm, abs=1e-3)
