"""What the counts say of each effect that was solved for: how large it is, how likely chance is to look like it, what was learned of it.

With d the departure of an effect's q values from what the rig stated, and C their covariance, d' C^-1 d / q is as an F of q and the
noise's degrees of freedom while there is none (chi-squared over q where the noise is stated). An effect is found where its probability,
times the number of those that were solved for (Bonferroni), is under `CHANCE`. What was learned is log2 of the prior's volume over that
which is left, half of det(prior)/det(C): none where a law cannot be told from that of what else was solved.
"""

import math

import numpy as np
import scipy.stats

from lmeasure.calibration.solve.effect_candidates import CHANCE
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.estimation import Fit
from lmeasure.rig import FURTHER, TABLE, TILT, SolvedEffect

LAWS = ("radius", "scale", "pitch", *dict.fromkeys(p.group for p in (*FURTHER, *TILT)))
"""Groups of parameters that are effects and no matter of where things stand."""
_GROUP = {p.key: p.group for p in (*TABLE, *FURTHER, *TILT)}


def solved_effects(model: Model, found: Fit, *, estimated: bool) -> tuple[SolvedEffect, ...]:
    """Each effect of each observation point that was solved for; estimated: whether the noise was, from the residuals."""
    unknowns = model.parameters
    own: dict[tuple[str, str], list[int]] = {}
    for i, name in enumerate(unknowns.names):
        owner, _, key = name.rpartition(".")
        if not owner.startswith("tool.") and _GROUP.get(key) in LAWS:
            own.setdefault((owner, _GROUP[key]), []).append(i)
    out = []
    for (owner, group), which in own.items():
        d, C = found.theta[which] - unknowns.nominal[which], found.covariance[np.ix_(which, which)]
        u = np.sqrt(np.diag(C))
        square = float(d @ np.linalg.solve(C, d)) / len(d)
        law = scipy.stats.f(len(d), found.freedom) if estimated else scipy.stats.chi2(len(d), scale=1.0 / len(d))
        bits = float(np.sum(np.log2(unknowns.width[which]))) - 0.5 * float(np.linalg.slogdet(C)[1]) / math.log(2.0)
        size = float(np.linalg.norm(d))
        p = float(law.sf(square))
        along = d / size if size > 0.0 else np.full(len(d), len(d) ** -0.5)
        out.append(
            SolvedEffect(
                owner=owner,
                effect=group,
                value=size,
                u=float(np.sqrt(along @ C @ along)) if size > 0.0 else float(u.max()),
                unit=unknowns.names[which[0]].rpartition("_")[2] if group != "scale" else "",
                probability=p,
                bits=max(bits, 0.0),
                found=p * len(own) < CHANCE,
            )
        )
    return tuple(out)
