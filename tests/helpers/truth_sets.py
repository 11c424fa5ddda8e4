"""Sets of an independent simulator with drums and swivel encoders (tests/authorities/truth) as channels and readings."""

from pathlib import Path
from tomllib import loads
from typing import Any

import numpy as np
from reference.cable import CableLength
from reference.rig_channels import cable_lengths, swivel_angle
from reference.swivel import SwivelAngle
from rigs import FloatArray

from lmeasure.rig import rig_from_dict

AUTHORITY = Path(__file__).parents[1] / "authorities" / "truth"


class Set:
    """A set's channels, and readings (n, m), drums first, of its table of counts; start (7,): where the counters were zeroed."""

    def __init__(self, name: str, start: FloatArray | None, counts: str = "pass1.csv") -> None:
        self.folder = AUTHORITY / name
        data: dict[str, Any] = loads((self.folder / "rig.toml").read_text())
        encoders = data.pop("swivel", [])
        rig = rig_from_dict(data)
        self.cables: list[CableLength] = cable_lengths(rig, start)
        to = {c.from_point: c.to_point for c in rig.cable}
        self.swivels: list[SwivelAngle] = [
            swivel_angle(
                rig,
                e["channel"],
                e["point"],
                to[e["point"]],
                counts_per_revolution=e["counts_per_revolution"],
                zero_deg=e["zero_deg"],
                u_zero_deg=e.get("u_zero_deg", 0.0),
            )
            for e in encoders
        ]
        with (self.folder / counts).open() as file:
            columns = file.readline().strip().split(",")
            table = dict(zip(columns, np.loadtxt(file, delimiter=",").T, strict=True))
        signs = [rig.point(c.from_point).drum.count_sign for c in rig.cable]
        lengths = [o.readings(table[o.name], sign) for o, sign in zip(self.cables, signs, strict=True)]
        angles = [2.0 * np.pi / e["counts_per_revolution"] * e["count_sign"] * table[e["channel"]] for e in encoders]
        self.readings = np.stack(lengths + angles, axis=1)
