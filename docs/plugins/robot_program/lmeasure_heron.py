"""Programs of the Heron, a controller that does not exist. Poses are in mm and degrees, with fixed angles about x, y and z:

GO P1 AT 100.0 200.0 300.0 0.0 90.0 0.0
"""

import math
import re
from collections.abc import Sequence

import numpy as np

from lmeasure.robot_programs import Dialect, Listing, Source, Target, Unread, of_angles

LINE = re.compile(r"^GO[ \t]+(\w+)[ \t]+AT(.*)$", re.MULTILINE)
NUMBER = re.compile(r"(?<!\S)[-+]?\d+(?:\.\d*)?(?!\S)")
NO_SHIFT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Position [mm] and quaternion x, y, z, w."""


def read(sources: Sequence[Source]) -> Listing:
    """Return the targets of a program with the places of their numbers, and the lines that were not understood."""
    targets, unread = [], []
    for k, source in enumerate(sources):
        for line in LINE.finditer(source.text):
            numbers = list(NUMBER.finditer(source.text, *line.span(2)))
            number = source.line(line.start())
            if len(numbers) != 6:
                unread.append(Unread(source.name, number, f"{line[1]}: {len(numbers)} numbers, and a pose has 6"))
                continue
            values, spans = tuple(float(n[0]) for n in numbers), tuple(n.span() for n in numbers)
            targets.append(Target(line[1], k, number, False, values, spans, "world", "flange", moved=(k, line.start())))
    return Listing(tuple(sources), tuple(targets), {"world": NO_SHIFT, "flange": NO_SHIFT}, tuple(unread))


pose, numbers = of_angles("fanuc-wpr")
DIALECT = Dialect(name="heron", read=read, pose=pose, numbers=numbers, joint_size=math.radians(1.0), decimals=(3, 3, 3), suffixes=(".hrn",))
