"""Files of a new rig, with comments: definition of each dimension, way to measure it, and effect of an error on the measured position."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.io import shipped
from lmeasure.kernels import counts_from_changes, span_lengths, twists
from lmeasure.rig import FACTORS, GUIDE, PLACE, TYPICAL_SIZES, Drum, ObservationPoint, Rig, parameter_names
from lmeasure.sensors import count_variance, length_gradients_since
from lmeasure.templates.shapes import HALF_MM, TILT_RAD

NODES = 3


@dataclass(frozen=True)
class Cost:
    """The largest error of the tool's position [mm] in a box by one unit of an error of the rig file, in the worst direction if there are
    several. unit: 1 mm, 1 deg, or a usual size."""

    unit: str
    mm: float


def box_poses() -> FloatArray:
    """(n, 7) poses of a box about the base frame's origin: its corners, middles and centre, with every tilt."""
    places = np.array(list(itertools.product(np.linspace(-HALF_MM, HALF_MM, NODES), repeat=3)))
    turns = [np.zeros(3), *(sign * TILT_RAD * np.eye(3)[i] for i in range(3) for sign in (-1.0, 1.0))]
    return np.concatenate([se3.pose(places, Rotation.from_rotvec(np.tile(turn, (len(places), 1)))) for turn in turns])


def position_errors(rig: Rig, zeroed_at: FloatArray, poses: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """(n, 3, q) errors of the tool's position [mm] at poses (n, 7) by one unit of an error of each parameter names (q,) of the rig, whose
    counters were zeroed at a pose (7,); first order. A parameter that several cables share has one error."""
    rows, weights = rig.cable_rows(), np.sqrt(1.0 / count_variance(rig))
    begun = span_lengths(rows, zeroed_at[None])
    counts = counts_from_changes(rows, np.ascontiguousarray(span_lengths(rows, poses) - begun))
    gradients = length_gradients_since(rig, rig.cable, zeroed_at, poses, counts=counts)
    of = np.array([[[name == one for one in names] for name in own] for own in parameter_names(rig)]) * FACTORS[:, None]
    # a reading that should be larger is fitted by a pose with the opposite error
    errors = twists(rows, poses, np.tile(weights / weights.max(), (len(poses), 1)), np.arange(6)) @ np.einsum("nmw,mwq->nmq", gradients, of)
    return -np.asarray(errors[:, 3:])


def costs(rig: Rig) -> dict[str, Cost]:
    """Return the costs of errors by `B1.position_mm`, `B1.guide`, `B1.pulley_radius_mm`, the keys of its drum, and `P1`."""
    start, box = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), box_poses()

    def worst(*names: str) -> float:
        # of all directions of an error of length 1, the one that moves the tool most, where the cables can run at all
        errors = position_errors(rig, start, box, names)
        return float(np.linalg.norm(errors[np.isfinite(errors).all(axis=(1, 2))], ord=2, axis=(1, 2)).max(initial=0.0))

    out: dict[str, Cost] = {}
    for name in dict.fromkeys(c.from_point for c in rig.cable):
        out[f"{name}.position_mm"] = Cost("1 mm", worst(*(f"{name}.{key}" for key in PLACE)))
        out[f"{name}.guide"] = Cost("1 deg", max(worst(f"{name}.{key}") for key in GUIDE))
        out[f"{name}.count_length_mm"] = Cost("0.1 %", 1e-3 * worst(f"{name}.scale"))
        out[f"{name}.groove_pitch_mm"] = Cost("0.1 mm", 0.1 * worst(f"{name}.groove_pitch_mm"))
        for key in ("pulley_radius_mm", "tangent_length_mm", "axial_offset_mm"):
            out[f"{name}.{key}"] = Cost("1 mm", worst(f"{name}.{key}"))
    for point in dict.fromkeys(c.to_point for c in rig.cable):
        out[point] = Cost("1 mm", worst(*(f"tool.{point}.{axis}_mm" for axis in "xyz")))
    return out


PICTURE = "docs/images/cable.svg"
HEAD = """\
# {about}.
#
# Lengths are in millimetres and angles in degrees, in the robot's base frame (right-handed, Z up). Letters in quotation
# marks are those of the picture {picture}. docs/rig.md explains every key.
#
# "error of 1 mm: up to 0.5 mm" is the largest error of a measured position before calibration, if the value is wrong by
# 1 mm. It is computed for this rig, within {half:.0f} mm of the zero pose along each axis and with tilts up to {tilt:g} rad.
# Calibration estimates positions and guides, if they are right within 100 mm and 15 degrees. Measure the other values,
# or leave them in "assumed".

schema = "lmeasure.rig/1"
name = {name}
# Angle convention of the controller; other values: {others}.
angles = {angles}

# Guessed values: they get wide priors, and reports name them. `lmeasure drum` removes the values that it computes.
assumed = [{assumed}]

# An uncertainty that you do not state has a typical size. Lines such as "# u_run_out_mm = 0.02" show it: measure it, write
# the smaller size, and remove the "#", in each table. run.toml states start pose and temperature:
# {of_run}.
# unstated = "exact"  # all that is not stated is exact: for simulations
{of_rig}
"""
POINT_KEYS = {
    "position_mm": "\"B\": contact of the swivel axis with the pulley's groove. Tape measure from the robot's base, within 30 mm",
    "guide_alpha_deg": '"α": inclination of the path from B to the fixed pulley, downwards. Protractor or level, within 5 degrees',
    "guide_beta_deg": "direction of that path on the floor, from +Y towards +X. Protractor or tape measure, within 5 degrees",
    "pulley_radius_mm": '"R": radius to the middle of the cable. Caliper: half the diameter of the groove\'s bottom plus half the cable',
}
DRUM_KEYS = {
    "counts_per_revolution": "counts per turn of the drum. Turn the drum once and read the counter, or use `lmeasure check`",
    "count_length_mm": "cable length per count. Pull 2 m along a tape measure and divide by the counts",
    "groove_pitch_mm": 'distance from groove to groove. Ruler over ten grooves, divided by ten; negative if paying out shortens "axial(k)"',
    "tangent_length_mm": '"tangent length" from drum to fixed pulley. `lmeasure drum` computes it from distances',
    "axial_offset_mm": '"axial(k)" at the zero pose: pay-out point to the fixed pulley\'s plane. `lmeasure drum` computes it',
}
DRUM_REST = """\
count_sign = {sign}                 # 1: counts rise as cable is paid out; -1: they fall. `lmeasure check` finds the sign
# counter_bits = 32            # width of the counter, after which it wraps around; default: inferred from jumps
# max_cable_speed_mm_s = 20000 # largest cable speed; faster changes of the count are faults
"""
TOOL = """\
# Attachment points "P" in the controller's tool frame. Caliper or drawing of the tool, from its origin along its axes.
[tool]
"""
CABLES = """\
# Cables: observation point, attachment point and counter channel. The n-th channel is node n of the CAN bus, unless a
# table [can] states other frames (docs/acquisition.md). If runs start at other poses than the calibration, state
# zero_length_mm of each cable: its length from B to the attachment point where axial_offset_mm was measured, within 10 mm.
"""


def rig_text(rig: Rig, about: str, schema: str = "") -> str:
    """Return a commented rig.toml; schema: path of its JSON Schema, empty for none."""
    cost = costs(rig)
    parts = [(f"#:schema {schema}\n" if schema else "") + _head(rig, about)]
    parts += [_point(point, cost, number == 0) for number, point in enumerate(rig.observation_point)]
    parts.append(TOOL + "".join(f"{name} = {_numbers(at)}{_cost(cost.get(name))}\n" for name, at in rig.tool.items()))
    cables = "\n".join(
        f'[[cable]]\nname = "{c.name}"\nchannel = "{c.channel}"\nfrom = "{c.from_point}"\nto = "{c.to_point}"\n'
        + (f"pass = {c.passage}\n" if c.passage > 1 else "")
        for c in rig.cable
    )
    return "\n".join([*parts, CABLES + cables])


def _head(rig: Rig, about: str) -> str:
    from lmeasure.core import CONVENTIONS

    lines = [f"\n  {', '.join(_text(n) for n in rig.assumed if n.startswith(f'{p.name}.'))}," for p in rig.observation_point]
    return HEAD.format(
        about=about[0].upper() + about[1:],
        picture=PICTURE,
        half=HALF_MM,
        tilt=TILT_RAD,
        name=_text(rig.name),
        angles=_text(rig.angles),
        others=", ".join(name for name in CONVENTIONS if name != rig.angles),
        assumed="".join(line for line in lines if line.strip(" ,\n")) + "\n" * bool(rig.assumed),
        of_run=", ".join(f"{key} {TYPICAL_SIZES[key].size}" for key in ("u_position_mm", "u_rotation_deg", "temperature_c")),
        of_rig="\n".join(_typical_sizes(Rig)),
    )


def _typical_sizes(table: type[Rig | ObservationPoint | Drum], count_length_mm: float = 0.0) -> list[str]:
    """Return the typical sizes of a table's keys as comments with their reasons."""
    own = [s for s in TYPICAL_SIZES.values() if s.key in table.model_fields and s.key.startswith("u_") and not s.code.startswith("start")]
    return [f"# {s.key} = {s.value * (count_length_mm if s.relative else 1.0):g}  # {s.what}: {s.reason}" for s in own]


def _point(point: ObservationPoint, cost: Mapping[str, Cost], first: bool) -> str:
    """Return the table of a point: the first with definitions and costs, the others with costs only."""
    lines = ["[[observation_point]]", f'name = "{point.name}"']
    for key, text in POINT_KEYS.items():
        value = getattr(point, key)
        known = cost.get(f"{point.name}.{'guide' if key.startswith('guide') else key}")
        lines += _line(key, _numbers(value) if isinstance(value, tuple) else repr(value), text if first else "", known)
    lines += [*(_typical_sizes(ObservationPoint) if first else ()), "[observation_point.drum]"]
    for key, text in DRUM_KEYS.items():
        lines += _line(key, repr(getattr(point.drum, key)), text if first else "", cost.get(f"{point.name}.{key}"))
    sizes = "".join(f"{line}\n" for line in _typical_sizes(Drum, point.drum.count_length_mm))
    rest = DRUM_REST.format(sign=point.drum.count_sign) + sizes if first else f"count_sign = {point.drum.count_sign}\n"
    return "\n".join(lines) + "\n" + rest


def _line(key: str, value: str, text: str, cost: Cost | None) -> list[str]:
    comment = [f"# {text}"] if text else []
    return [*comment, f"{key} = {value}{_cost(cost)}"]


def _cost(cost: Cost | None) -> str:
    return "" if cost is None or cost.mm == 0.0 else f"  # error of {cost.unit}: up to {cost.mm:.2g} mm"


def _text(text: str) -> str:
    import json

    return json.dumps(text, ensure_ascii=False)


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(repr(float(v)) for v in values)}]"


DRUMS_HEAD = """\
#:schema schemas/drums.json
# Measured dimensions of the drums; docs/drum.md has the picture. Then run:
#     lmeasure drum drums.toml --rig rig.toml --out measured.toml
# The key of a standard uncertainty is u_ and the key of the value: u_centre_distance_mm = 0.5
schema = "lmeasure.drum/1"
"""
DRUMS_KEYS = (
    ("counts_per_revolution", "{counts}", "N: counts per turn. Turn the drum once and read the counter"),
    ("groove_pitch_mm", "{pitch}", "t_m: distance from groove to groove. Ruler over ten grooves, divided by ten"),
    ("count_length_mm", "{count}", "c: cable length per count. Pull 2 m along a tape measure and divide by the counts"),
    ("fixed_pulley_radius_mm", "20.0", "R2: caliper, half the diameter of the groove's bottom plus half the cable"),
    ("centre_distance_mm", "{distance}", "a: perpendicular distance between the axes of drum and fixed pulley"),
    ("pulley_plane_mm", "40.0", "C: axial distance from the drum's end face to the fixed pulley's middle plane"),
    ("cable_end_mm", "5.0", "g: axial distance from the same end face to the fastened end of the cable"),
    ("full_wind_counts", "60000", "K: robot at the zero pose; unwind the cable to its end, zero the counter, wind until taut, read it"),
)
PLACEMENT = """\
#:schema schemas/placement.json
# Task of the robot, and boxes for the observation points. Then run:
#     lmeasure place rig.toml --task placement.toml --out placed
schema = "lmeasure.placement/1"
objective = "pressure_angle"   # or "u95": quantity to minimise at the worst pose of the task
tolerance_mm = 5.0             # mounting tolerance of a point, per axis

[task]                         # box of the tool origin, base frame, with tilts of the tool
low_mm = [{low}, {low}, {low}]
high_mm = [{high}, {high}, {high}]
nodes = 3                      # evaluated positions along each edge
tilt_rad = {tilt}
tilt_steps = 3

# [[keep_out]]                 # box without points: the robot, a door
# low_mm = [-500.0, -500.0, -500.0]
# high_mm = [500.0, 500.0, 500.0]
"""
SCENARIO = """\
#:schema schemas/scenario.json
# Simulation of this rig, to try every step before it is built:
#     lmeasure simulate scenario.toml --out tried
#     lmeasure calibrate tried/calibration --out tried/calibrated
#     lmeasure reconstruct tried --rig tried/calibrated/rig.toml --out tried/trajectory.parquet
# `lmeasure record --bus simulated:scenario.toml` uses it in place of a bus.
schema = "lmeasure.scenario/1"
rig = "rig.toml"
rate_hz = 250

[motion]
speed_mm_s = 250.0
dwell_s = 1.0

[[waypoint]]
position_mm = [0, 0, 0]        # rest at the start, for the closure
[[waypoint]]
position_mm = [150, 100, 50]
[[waypoint]]
position_mm = [-100, 150, -50]

[reference_poses]              # calibration campaign around the start
count = 20
u_position_mm = 0.05           # standard uncertainty of the poses, by laser tracker or robot
u_rotation_deg = 0.01
"""


def folder_files(rig: Rig, about: str) -> dict[str, str]:
    """Return the files of a new folder by name: rig, drums, task for `place`, scenario, schemas."""
    out = {
        "rig.toml": rig_text(rig, about, "schemas/rig.json"),
        "drums.toml": _drums(rig),
        "placement.toml": _placement(rig),
        "scenario.toml": SCENARIO,
    }
    return out | {f"schemas/{name.removesuffix('.toml')}.json": shipped(name.removesuffix(".toml")) for name in out}


def _drums(rig: Rig) -> str:
    parts = [DRUMS_HEAD]
    for number, p in enumerate(rig.observation_point):
        # equal radii of drum and pulley: then the tangent is the distance of the axes
        values = {
            "counts": p.drum.counts_per_revolution, "pitch": abs(p.drum.groove_pitch_mm), "count": p.drum.count_length_mm,
            "distance": p.drum.tangent_length_mm,
        }  # fmt: skip
        lines = [f"{key} = {value.format(**values)}" + (f"  # {text}" if number == 0 else "") for key, value, text in DRUMS_KEYS]
        parts.append("\n".join(["[[drum]]", f'point = "{p.name}"', *lines, ""]))
    return "\n".join(parts)


def _placement(rig: Rig) -> str:
    boxes = [
        f'[[mount]]\npoints = ["{p.name}"]\nlow_mm = {_numbers(tuple(v - HALF_MM for v in p.position_mm))}\n'
        f"high_mm = {_numbers(tuple(v + HALF_MM for v in p.position_mm))}\n"
        for p in rig.observation_point
    ]
    head = PLACEMENT.format(low=-HALF_MM, high=HALF_MM, tilt=TILT_RAD)
    return "\n".join([head, "# Box for each observation point; a flat box is a wall or a beam.", *boxes])
