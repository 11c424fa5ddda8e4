"""One robot measured by several laboratories: agreement of their results, the consensus, and outlying laboratories.

The n results x_i have standard uncertainties u_i. All laboratories share the part c of them (the same traceability). The robot itself
differs between the measurements by a standard uncertainty a. The independent variances are v_i = u_i^2 + a^2 - c^2, and

    weighted mean       m = sum(x_i / v_i) / W, W = sum(1 / v_i), u(m)^2 = 1/W + c^2         (Cox, Metrologia 39 (2002), procedure A)
    consistency         Q = sum((x_i - m)^2 / v_i), chi-squared of n - 1 degrees of freedom
    Birge ratio         R = sqrt(Q / (n - 1))                                                (Birge, Phys. Rev. 40 (1932))
    random effects      t^2 = max(0, (Q - n + 1) / (W - sum(1 / v_i^2) / W)), weights 1 / (v_i + t^2)
                                                                    (DerSimonian and Laird, Controlled Clin. Trials 7 (1986))
    equivalence         d_i = x_i - m, u(d_i)^2 = v_i - 1/W; of a laboratory that is not in the mean v_i + 1/W
    scores              zeta_i = d_i / u(d_i), E_n = d_i / (2 u(d_i))                        (ISO 13528:2022, 9.6 and 9.7)

If Q is improbable, the laboratory farthest off is removed from the mean, and so on: the largest consistent subset (Cox, Metrologia 44
(2007)). It is searched one laboratory at a time and keeps more than half of them; without such a subset, the random effects' mean is the
consensus and no laboratory is an outlier.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from lmeasure.certificate.bundle import CERTIFICATE
from lmeasure.certificate.dcc import DccResult, read_dcc
from lmeasure.certificate.verification import read_certificate, with_u95
from lmeasure.core import CertificationError, FloatArray
from lmeasure.text import Message, message

CONSISTENT = 0.05
"""Probability of chance under which results do not agree."""
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Laboratory:
    """Results of one laboratory by name: value, standard uncertainty and unit."""

    name: str
    results: Mapping[str, tuple[float, float, str]]


@dataclass(frozen=True)
class Equivalence:
    """The result of a laboratory beside the consensus: difference d, its standard uncertainty, scores, and whether it is in the mean."""

    laboratory: str
    value: float
    u: float
    difference: float
    u_difference: float
    zeta: float
    e_n: float
    in_mean: bool


@dataclass(frozen=True)
class Consensus:
    """Hold the consensus of n laboratories on one result.

    value, u: the consensus, found by `method`: "weighted mean", "largest consistent subset" or "random effects". q, probability:
    of all results about their weighted mean; birge: their Birge ratio; between: standard deviation between laboratories. random_effects:
    value and standard uncertainty of the random effects' mean, whatever the method.
    """

    name: str
    unit: str
    value: float
    u: float
    method: str
    q: float
    probability: float
    birge: float
    between: float
    random_effects: tuple[float, float]
    laboratories: tuple[Equivalence, ...]

    @property
    def outlying(self) -> tuple[str, ...]:
        """Laboratories that are not in the mean."""
        return tuple(e.laboratory for e in self.laboratories if not e.in_mean)


def read_laboratory(path: Path) -> Laboratory:
    """Read a certificate's folder, certificate.json, or a DCC of any program.

    Raises
    ------
    CertificationError
        If it states no result with an uncertainty.
    FileFormatError
        If it cannot be read.
    """
    if path.suffix.lower() == ".xml":
        dcc = read_dcc(path)
        name, results = dcc.laboratory, [r for r in dcc.results if r.u is not None and r.u > 0.0]
    else:
        content = read_certificate(path / CERTIFICATE if path.is_dir() else path)
        name = content["details"].get("laboratory", {}).get("name", "")
        results = [_of_figure(f) for f in content["characteristics"] if f.get("u95")]
    if not results:
        raise CertificationError(message("error.states_no_result_with", where=path))
    return Laboratory(name or str(path), {r.name: (r.value, float(r.u or 0.0), r.unit) for r in results})


def _of_figure(figure: Mapping[str, Any]) -> DccResult:
    where = " ".join(str(figure[key]) for key in ("pose", "path", "part") if figure.get(key) is not None)
    u = figure["u95"] / (figure.get("coverage_factor") or NORMAL_95)
    return DccResult(f"{figure['name']} {where}".strip(), float(figure["value"]), figure["unit"], u)


def compare_laboratories(laboratories: Sequence[Laboratory], *, common_mm: float = 0.0, artefact_mm: float = 0.0) -> tuple[Consensus, ...]:
    """Return the consensus of every result that two or more laboratories state in the same unit.

    Parameters
    ----------
    laboratories
        Two or more, with different names.
    common_mm
        Standard uncertainty that all results in mm share.
    artefact_mm
        Standard uncertainty by which the robot differs between the measurements, for results in mm.

    Raises
    ------
    CertificationError
        If fewer than two laboratories are given, two have one name, or they have no result in common.
    """
    names = [one.name for one in laboratories]
    if len(names) < 2:
        raise CertificationError(message("error.a_comparison_between_laboratories"))
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise CertificationError(message("error.two_certificates_are_of", twice=twice))
    out = []
    for result in dict.fromkeys(name for one in laboratories for name in one.results):
        stating = [one for one in laboratories if result in one.results]
        units = {one.results[result][2] for one in stating}
        if len(units) > 1:
            raise CertificationError(message("error.is_stated_in", where=result, units=" and ".join(sorted(units))))
        if len(stating) > 1:
            unit = units.pop()
            common, artefact = (common_mm, artefact_mm) if unit == "mm" else (0.0, 0.0)
            x, u = np.array([one.results[result][:2] for one in stating]).T
            out.append(consensus(result, [one.name for one in stating], x, u, unit=unit, common=common, artefact=artefact))
    if not out:
        raise CertificationError(message("error.have_no_result_in", where=", ".join(names)))
    return tuple(out)


def consensus(
    result: str, names: Sequence[str], x: FloatArray, u: FloatArray, *, unit: str = "", common: float = 0.0, artefact: float = 0.0
) -> Consensus:
    """Return the consensus of results (n,) with standard uncertainties (n,); see the text of this module."""
    if (u <= common).any():
        name = names[int(np.argmin(u))]
        raise CertificationError(message("error.states_u_no_more", where=result, name=name, u=u.min(), unit=unit, common=common))
    v = u**2 + artefact**2 - common**2
    n, weights = len(x), 1.0 / v
    q = _mean(x, weights)[1]
    spread = max(0.0, (q - n + 1) / (weights.sum() - (weights**2).sum() / weights.sum()))
    random = 1.0 / (v + spread)
    mean_of_all = _mean(x, random)[0], math.sqrt(1.0 / random.sum() + common**2)
    within, method = np.ones(n, dtype=np.bool_), "weighted mean"
    while not _consistent(x[within], weights[within]):
        # the farthest off by its own uncertainty
        among = np.flatnonzero(within)
        center, total = _mean(x[within], weights[within])[0], weights[within].sum()
        off = np.abs(x[among] - center) / np.sqrt(v[among] - 1.0 / total)
        within[among[np.argmax(off)]] = False
        method = "largest consistent subset"
        if 2 * within.sum() <= n:
            within[:], method, weights = True, "random effects", random
            break
    value, total = _mean(x[within], weights[within])[0], float(weights[within].sum())
    own = 1.0 / weights
    u_difference = np.sqrt(np.where(within, own - 1.0 / total, own + 1.0 / total))
    d = x - value
    rows = zip(names, x, u, d, u_difference, within, strict=True)
    return Consensus(
        name=result,
        unit=unit,
        value=value,
        u=math.sqrt(1.0 / total + common**2),
        method=method,
        q=q,
        probability=float(scipy.stats.chi2.sf(q, n - 1)),
        birge=math.sqrt(q / (n - 1)),
        between=math.sqrt(spread),
        random_effects=mean_of_all,
        laboratories=tuple(
            Equivalence(name, float(a), float(b), float(off), float(s), float(off / s), float(0.5 * off / s), bool(part))
            for name, a, b, off, s, part in rows
        ),
    )


def _mean(x: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Return the weighted mean, and Q about it."""
    mean = float(weights @ x / weights.sum())
    return mean, float(weights @ (x - mean) ** 2)


def _consistent(x: FloatArray, weights: FloatArray) -> bool:
    return len(x) < 2 or bool(scipy.stats.chi2.sf(_mean(x, weights)[1], len(x) - 1) >= CONSISTENT)


def laboratory_lines(found: Sequence[Consensus]) -> list[Message]:
    """Return the lines for a person: each consensus, and each laboratory that does not agree."""
    out = []
    for one in found:
        value, u95 = with_u95(one.value, 2.0 * one.u)
        about = {"result": one.name, "value": value, "u95": u95, "unit": one.unit, "count": len(one.laboratories)}
        out.append(message(f"between.{one.method.replace(' ', '_')}", **about, p=one.probability, birge=one.birge))
        out += [
            message("between.apart", laboratory=e.laboratory, difference=e.difference, unit=one.unit, e_n=e.e_n)
            for e in one.laboratories
            if abs(e.e_n) > 1.0
        ]
    return out


def as_json(found: Sequence[Consensus]) -> dict[str, Any]:
    """Return the content of the comparison's file."""
    return {"schema": "lmeasure.between/1", "results": [asdict(one) | {"outlying": list(one.outlying)} for one in found]}
