"""The notebooks in docs/notebooks, written from the cells below: python docs/make_notebooks.py [FOLDER]. They are kept without outputs."""

import sys
from pathlib import Path

import nbformat

SCENARIO = """at = {"P1": [200.0, 200.0, 100.0], "P2": [-200.0, 200.0, -100.0], "P3": [-200.0, -200.0, 100.0]}
asked = {
    "waypoint": [{"position_mm": p} for p in at.values()],
    "motion": {"speed_mm_s": 900.0, "cycles": 3, "dwell_s": 0.8},
    "reference_poses": {"count": 12, "u_position_mm": 0.02},
}
made = lm.simulate(asked, rig=lm.read_rig(RIG), rate_hz=50.0)"""
HEAD = '''import lmeasure as lm

RIG = "../../tests/authorities/truth/cell-run/rig.toml"'''

NOTEBOOKS: dict[str, list[str]] = {
    "rig-to-certificate": [
        "# From a rig to its certificate\n"
        "A simulated robot runs between three poses; the instrument is calibrated, and says what the robot is worth.",
        HEAD,
        "## The rig\nSix cables from six observation points. An object prints a table here, and `lm.plot` draws it.",
        "rig = lm.read_rig(RIG)\nrig",
        "lm.plot(rig)",
        "## Counts of a motion\n`simulate` stands for the counters: what they would record, and the true poses beside it.",
        SCENARIO + "\nmade",
        "## Calibration\nObservation points and guides from counts at twelve known poses, with what the counts can and cannot tell.",
        "calibration = lm.calibrate(made)\ncalibration",
        'calibration.to_frame().head(12)',
        "lm.plot(calibration)",
        "## The trajectory and the certificate",
        "trajectory = lm.reconstruct(made, rig=calibration)\ntrajectory",
        'poses = [{"name": n, "position_mm": p, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]} for n, p in at.items()]\n'
        'program = lm.Program(schema="lmeasure.program/1", pose=poses)\n'
        'certificate = lm.certify(trajectory, program, "certificate", run=made, rig=calibration)\ncertificate',
        "lm.plot(certificate)",
        "## A third party computes every figure again",
        "verified = lm.verify(certificate)\nassert verified.differences == ()\nverified.differences",
    ],
    "trajectory-and-uncertainty": [
        "# A trajectory and its uncertainty\n"
        "Where the gripper was, how well that is known, and whether what is stated holds against the truth.",
        "import numpy as np\nimport pandas as pd\n\n" + HEAD,
        'run = lm.read_run("../../tests/authorities/truth/cell-run")\nrun',
        "trajectory = lm.reconstruct(run)\ntrajectory",
        "## As a table\nEvery column carries its unit in its name; a pose that is not `ok` holds NaN, never a guess.",
        'trajectory.to_frame()[["time_s", "x_mm", "y_mm", "z_mm", "u_x_mm", "u_y_mm", "u_z_mm", "status"]].head()',
        "lm.plot(trajectory, run.rig)",
        "## Against the truth\n"
        "An independent simulator made these counts. The errors are compared with what was stated without knowing it.",
        'truth = pd.read_csv("../../tests/authorities/truth/cell-run/truth.csv.gz")\n'
        'error = trajectory.poses[:, :3] - truth[["x_mm", "y_mm", "z_mm"]].to_numpy()\n'
        "stated = trajectory.u[:, :3]\n"
        "rms, u = np.sqrt((error**2).sum(axis=1).mean()), np.sqrt((stated**2).sum(axis=1).mean())\n"
        'print(f"error {1e3 * rms:.2f} um rms, stated {1e3 * u:.2f} um")\n'
        "assert rms < 2.0 * u",
        "## Two samples err together\nWhat all samples share, as the zero phase of the counters, is the same error at each of them.",
        "covariances = lm.covariances(trajectory, run)\ncovariances.factors.shape, covariances.sources",
    ],
    "designing-a-zone": [
        "# Designing a zone\nWhere in the cell the instrument is good enough, and what it would take to be better.",
        HEAD,
        "rig = lm.read_rig(RIG)\nzone = lm.zone(rig, (-400, 400, 100), (-400, 400, 100), (-300, 300, 100), tilt_rad=0.2)\nzone",
        "lm.plot(zone, rig)",
        "lm.plot(zone)",
        "## A tighter limit\nWhat is left where the place must be known to 10 µm, of the counts alone.",
        'def litres(zone):\n    return zone.attrs["zone_volume_mm3"] / 1e6\n\n\n'
        "fine = lm.zone(rig, (-400, 400, 100), (-400, 400, 100), (-300, 300, 100), tilt_rad=0.2, u95_mm=0.012)\n"
        'print(f"{litres(zone):.0f} l by the pressure angle, {litres(fine):.0f} l by both")\nassert litres(fine) <= litres(zone)',
        "## What a calibration leaves\nThe same box with the uncertainty of a calibration at twelve poses in it.",
        SCENARIO
        + "\ncalibrated = lm.zone(lm.calibrate(made), (-200, 200, 200), (-200, 200, 200), (-200, 200, 200))\n"
        'float(calibrated["u95_position_mm"].max())',
        "## Which poses to measure next\nTwelve poses chosen for the lengths over the box, each with what it brings.",
        "plan = lm.plan_poses(rig, poses=6, box=[(-200, 200)] * 3, tilt_deg=15.0)\nplan",
        "plan.to_frame().head()",
    ],
}  # fmt: skip


def notebook(cells: list[str]) -> nbformat.NotebookNode:
    """A notebook of cells: prose begins with #, code does not."""
    made = nbformat.v4.new_notebook()
    for number, text in enumerate(cells):
        new = nbformat.v4.new_markdown_cell if text.startswith("#") else nbformat.v4.new_code_cell
        cell = new(text)
        cell["id"] = f"cell-{number}"
        made.cells.append(cell)
    made.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return made


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "notebooks"
    for name, cells in NOTEBOOKS.items():
        nbformat.write(notebook(cells), folder / f"{name}.ipynb")
