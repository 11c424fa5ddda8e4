"""Checks of this program against statements that share nothing with it: certified values, formulas in NumPy, simulations with the truth."""

import base64
import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scipy

from lmeasure import api
from lmeasure.certificate import canonical, environment, now, read_private_key, sign
from lmeasure.core import FloatArray, Status, se3
from lmeasure.io import files
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, GUIDE_XYZ, RADIUS, span_lengths
from lmeasure.qualification.nist_strd import judge_all
from lmeasure.qualification.published_budgets import EXAMPLES
from lmeasure.recording import Program
from lmeasure.report import qualification_pdf
from lmeasure.simulation import cell_rig
from lmeasure.text import Message, message
from lmeasure.trajectory import Trajectory

RUNS = 40
"""Simulated runs of the check of coverage."""
CHANCE = 1e-3
"""Probability with which a sound program fails the check of coverage."""
SPACING_MM = 1e-9


@dataclass(frozen=True)
class Check:
    """A check: code of its text, whether it passed, the found and the wanted value."""

    code: str
    passed: bool
    found: str
    wanted: str


def _within(code: str, mm: float) -> Check:
    """Return a check of a largest difference."""
    found, wanted = message("qualify.found.difference", mm=mm), message("qualify.wanted.difference", mm=SPACING_MM)
    return Check(code, mm < SPACING_MM, found, wanted)


def installed_files() -> Check:
    """Compare every installed file with the digest that its installer wrote down."""
    try:
        listed = [f for f in distribution("lmeasure").files or () if f.hash is not None and f.suffix != ".pyc"]
    except PackageNotFoundError:
        listed = []
    own = [f for f in listed if f.parts[0] == "lmeasure"]
    if not own:
        return Check("files", True, message("qualify.found.source_tree"), message("qualify.wanted.digests"))
    changed = [str(f) for f in own if f.hash is None or not _has_digest(Path(str(f.locate())), f.hash.mode, f.hash.value)]
    same = message("qualify.found.files_same", files=len(own))
    found = message("qualify.found.files", files=len(own), changed=len(changed), names=tuple(changed[:3])) if changed else same
    return Check("files", not changed, found, message("qualify.wanted.no_change"))


def _has_digest(path: Path, mode: str, value: str) -> bool:
    if not path.is_file():
        return False
    found = hashlib.new(mode, path.read_bytes()).digest()
    return base64.urlsafe_b64encode(found).rstrip(b"=").decode() == value


def regressions() -> Check:
    """Fit NIST's 27 nonlinear regressions from both starts."""
    every = list(judge_all())
    wrong = [f"{j.name} from start {j.start}" for j in every if not j.right]
    right = sum(j.right and j.converged for j in every)
    worst = min(every, key=lambda j: j.digits)
    values = {"all": len(every), "digits": worst.digits, "name": worst.name}
    other = {"right": right, "names": tuple(wrong[:3])}
    found = message("qualify.found.regressions", **values, **other) if wrong else message("qualify.found.regressions_right", **values)
    return Check("regressions", right == len(every), found, message("qualify.wanted.regressions", all=len(every), digits=4))


def budgets() -> Check:
    """Propagate the published examples of JCGM 100, 101 and 102 as certificates propagate."""
    every = {f"{e.name}, {name}": size for e in EXAMPLES for name, size in e.differences().items()}
    wrong = [name for name, size in every.items() if not size < 1.0]
    found = message("qualify.found.budgets", right=len(every) - len(wrong), all=len(every), names=tuple(wrong[:3]))
    right = message("qualify.found.budgets_right", all=len(every), examples=len(EXAMPLES))
    return Check("budgets", not wrong, found if wrong else right, message("qualify.wanted.budgets"))


def cable_lengths() -> Check:
    """Compare lengths around swivel pulleys with the closed form of a tangent to a circle, in NumPy."""
    rng, worst = np.random.default_rng(1), 0.0
    for seed in range(5):
        rows = cell_rig(seed).cable_rows()
        poses = se3.displaced(np.tile(np.r_[np.zeros(6), 1.0], (50, 1)), np.repeat([0.3, 200.0], 3) * rng.uniform(-1, 1, (50, 6)))
        own = np.column_stack([_length(row, se3.apply(poses, row[ATTACHMENT_XYZ])) for row in rows])
        worst = max(worst, float(np.abs(span_lengths(rows, poses) - own).max()))
    return _within("lengths", worst)


def _length(row: FloatArray, points: FloatArray) -> FloatArray:
    """Return R phi + straight part: with a, b the coordinates of P from the pulley's centre along u and n, a + ib = (L - iR) exp(i phi)."""
    u, radius, off = row[GUIDE_XYZ], row[RADIUS], points - row[BASE_XYZ]
    along = off @ u
    across = np.linalg.norm(off - along[:, None] * u, axis=1)
    a, b = along, across - radius
    straight = np.sqrt(a**2 + b**2 - radius**2)
    return np.asarray(radius * ((np.arctan2(b, a) + np.arctan2(radius, straight)) % (2.0 * np.pi)) + straight)


def _simulated(seed: int) -> tuple[Trajectory, FloatArray]:
    """Return a reconstructed run of a simulated cell, and its true poses."""
    corner = np.random.default_rng(seed).uniform(-80.0, 80.0, 3)
    simulated = api.simulate(seed=seed, rate_hz=20.0, waypoint=[{"position_mm": [float(v) for v in corner]}])
    assert simulated.run is not None
    return api.reconstruct(simulated.run), simulated.run.poses


def coverage() -> Check:
    """Count in how many simulated runs the true pose of one sample is in its 95 % region, and compare errors with their covariances."""
    squares = []
    for seed in range(RUNS):
        found, true = _simulated(seed)
        k = len(true) // 2
        if found.status[k] == Status.OK:
            error = se3.displacement(found.poses[k : k + 1], true[k : k + 1])[0]
            squares.append(float(error @ np.linalg.solve(found.random[k] + found.systematic[k], error)))
    held, n = sum(square <= scipy.stats.chi2.ppf(0.95, 6) for square in squares), len(squares)
    tails = (CHANCE / 4, 1.0 - CHANCE / 4)
    low, high = (int(scipy.stats.binom.ppf(q, RUNS, 0.95)) for q in tails)
    least, most = (scipy.stats.chi2.ppf(q, 6 * RUNS) / (6 * RUNS) for q in tails)
    ratio = float(np.mean(squares)) / 6.0 if squares else np.nan
    return Check(
        "coverage",
        bool(n == RUNS and low <= held <= high and least <= ratio <= most),
        message("qualify.found.coverage", held=int(held), all=n, ratio=ratio),
        message("qualify.wanted.coverage", low=low, high=high, all=RUNS, least=float(least), most=float(most)),
    )


def formulas() -> Check:
    """Compare pose accuracy and repeatability of ISO 9283 with a few lines of NumPy."""
    with TemporaryDirectory() as scratch:
        trajectory, program, attained, commanded = _test_of_a_robot(4, Path(scratch))
        found = {c.name: c.value for c in api.evaluate(trajectory, program).characteristics}
    off = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    wanted = {"AP_p": float(np.linalg.norm(attained.mean(axis=0) - commanded)), "RP_l": float(off.mean() + 3.0 * off.std(ddof=1))}
    worst = max(abs(found[name] - value) for name, value in wanted.items())
    return _within("formulas", worst)


def _test_of_a_robot(seed: int, folder: Path) -> tuple[Path, Program, FloatArray, FloatArray]:
    """Return the file of five visits of a pose, the program, and the attained positions (5, 3) about the commanded one (3,)."""
    commanded, visits = np.array([100.0, 50.0, -20.0]), 5
    attained = commanded + np.random.default_rng(seed).normal(0.1, 0.05, (visits, 3))
    stays = [place for one in attained for place in (one, commanded + [200.0, 0.0, 0.0])]
    places = np.concatenate([np.tile(place, (20, 1)) for place in stays])
    time_s = np.arange(len(places)) / 10.0
    rows = np.column_stack([time_s, places, np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))])
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    (folder / "measured.csv").write_text("\n".join(["time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", *lines]) + "\n", encoding="utf-8")
    windows = [[float(time_s[40 * i]), float(time_s[40 * i + 19])] for i in range(visits)]
    pose = {"name": "P1", "position_mm": commanded.tolist(), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "windows_s": windows}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
    return folder / "measured.csv", program, attained, commanded


def reproducibility() -> Check:
    """Compute one run twice, and compare all digits."""
    first, second = (_simulated(1)[0] for _ in range(2))
    same = first.poses.tobytes() == second.poses.tobytes() and first.random.tobytes() == second.random.tobytes()
    wanted = message("qualify.found.same_bytes")
    return Check("reproducibility", same, wanted if same else message("qualify.found.other_bytes"), wanted)


def sealed_certificates() -> Check:
    """Certify a simulated robot, verify the certificate, change one of its results, and verify it again."""
    with TemporaryDirectory() as scratch:
        trajectory, program, _, _ = _test_of_a_robot(5, Path(scratch))
        folder = Path(scratch) / "certificate"
        api.certify(trajectory, program, folder)
        good = api.verify(folder).exit_code
        copy = Path(scratch) / "changed"
        shutil.copytree(folder, copy)
        path = copy / "certificate.json"
        text = path.read_text(encoding="utf-8")
        begin = text.index('"value":') + len('"value":')
        digit = next(i for i in range(begin, len(text)) if text[i] in "12345678")
        path.write_text(f"{text[:digit]}{int(text[digit]) + 1}{text[digit + 1 :]}", encoding="utf-8")
        bad = api.verify(copy).exit_code
    found = message("qualify.found.exit_codes", sealed=good, changed=bad)
    return Check("certificates", (good, bad) == (0, 1), found, message("qualify.wanted.exit_codes"))


CHECKS: tuple[Callable[[], Check], ...] = (
    installed_files,
    regressions,
    budgets,
    cable_lengths,
    formulas,
    coverage,
    reproducibility,
    sealed_certificates,
)


JSON, PDF, SIGNATURE = "qualification.json", "qualification.pdf", "signature.json"


def run_checks(progress: Callable[[int, int], None]) -> tuple[Check, ...]:
    """Run all checks; one that ends in an error has failed."""
    out = []
    for i, check in enumerate(CHECKS):
        try:
            out.append(check())
        except Exception as error:  # a planted fault may break anything
            out.append(Check(check.__name__, False, f"{type(error).__name__}: {error}"[:300], message("qualify.wanted.no_error")))
        progress(i + 1, len(CHECKS))
    return tuple(out)


def write_qualification(folder: Path, checks: tuple[Check, ...], key: Path | None) -> dict[str, Any]:
    """Write qualification.json and .pdf, and the signature of the first if there is a key; the content of the first.

    Raises
    ------
    LMeasureError
        If the key cannot be read or a file cannot be written.
    """
    private = None if key is None else read_private_key(key)
    content = {
        "schema": "lmeasure.qualification/1",
        "created": now(),
        "passed": all(c.passed for c in checks),
        "checks": [vars(c) | {"text": str(check_text(c))} for c in checks],
        "environment": environment(()),
    }
    written = canonical(content)
    files.write_bytes(folder / JSON, written)
    files.write_bytes(folder / PDF, qualification_pdf(content))
    if private is not None:
        files.write_bytes(folder / SIGNATURE, canonical(sign(written, private) | {"signed": JSON}))
    return content


def check_text(check: Check) -> Message:
    """Return the purpose of a check."""
    return message(f"qualify.{check.code}")
